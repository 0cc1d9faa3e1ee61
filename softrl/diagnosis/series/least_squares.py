"""What a least-squares fit is worth, from its derivatives: covariance, and what other data would have left."""

import numpy as np

from softrl.diagnosis.series.blocks import block_sums

UNSEEN = 1e-6  # eigenvalue of the normalised normal matrix below which a direction counts as unseen
AT_END = 1e-6  # scaled distance from a bound below which a parameter sits on it


def sandwich(jacobian: np.ndarray, residual: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Return the covariance (p, p) of least-squares parameters, robust to dependence within blocks.

    Parameters
    ----------
    jacobian : (rows, p)
    residual : (rows,)
    blocks : (rows,) block number of every row
    """
    alive = np.linalg.norm(jacobian, axis=0) > 0.0
    if not alive.all():
        covariance = np.diag(np.where(alive, 0.0, np.inf))
        covariance[np.ix_(alive, alive)] = sandwich(jacobian[:, alive], residual, blocks) if alive.any() else 0.0
        return covariance
    count = int(blocks.max()) + 1
    score = block_sums(jacobian * residual[:, None], blocks)
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    seen, basis = np.linalg.eigh((jacobian / size).T @ (jacobian / size))
    seen = np.maximum(seen, UNSEEN**2)
    turned = (score / size) @ basis / seen
    covariance = count / max(count - len(size), 1) * turned.T @ turned
    # directions that the data hardly see get the variance of independent errors as well, which is huge there
    covariance += np.diag(np.where(seen < UNSEEN, float(np.mean(residual**2)) / seen, 0.0))
    return np.asarray(basis @ covariance @ basis.T / np.outer(size, size))


def jackknife(jacobian: np.ndarray, residual: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Return the standard error (p,) of least-squares parameters from fits to all folds but one, to first order.

    It holds what differs from run to run, a body that is not quite the robot's included, which no block within a run
    shows. Parameters without influence get an infinite one.
    """
    seen = np.linalg.norm(jacobian, axis=0) > 0.0
    spread = np.full(jacobian.shape[1], np.inf)
    size = np.linalg.norm(jacobian[:, seen], axis=0)
    scaled = jacobian[:, seen] / size
    held = np.diag(float(np.mean(residual**2)) / size**2)
    normal, count = scaled.T @ scaled + held, int(folds.max()) + 1
    moved = []
    for k in range(count):
        mine = scaled[folds == k]
        moved.append(np.linalg.solve(normal - mine.T @ mine, mine.T @ residual[folds == k]))
    change = np.array(moved)
    spread[seen] = np.sqrt((count - 1) / count * np.sum((change - change.mean(axis=0)) ** 2, axis=0)) / size
    return spread


def left_out(
    jacobian: np.ndarray, residual: np.ndarray, folds: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Return the residual (rows,) of every fold as a fit to the other folds would leave it, to first order.

    Parameters
    ----------
    jacobian, residual : (rows, p), (rows,) at the fit to all folds
    folds : (rows,) number of the fold of every row
    low, high : (p,) how far the parameters may move

    Notes
    -----
    One Gauss-Newton step on the other folds: with ``H_k = J_k' J_k`` and ``g_k = J_k' r_k`` the parameters move by
    ``(H - H_k)^-1 g_k``, the gradient ``g`` of the fit to all folds being taken as zero; ``H`` holds a prior of unit
    variance in the scaled parameters, so that those which nothing determines stay near.
    """
    found = residual.copy()
    slope = jacobian.T @ residual
    stuck = ((low > -AT_END) & (slope > 0.0)) | ((high < AT_END) & (slope < 0.0))
    seen = np.linalg.norm(jacobian, axis=0) > 0.0
    free: np.ndarray = np.flatnonzero(~stuck & seen)
    if not len(free):
        return found
    size = np.linalg.norm(jacobian[:, free], axis=0)
    scaled, low, high = jacobian[:, free] / size, low[free] * size, high[free] * size
    held = np.diag(float(np.mean(residual**2)) / size**2)
    for k in range(int(folds.max()) + 1):
        mine = folds == k
        rest = scaled[~mine]
        moved = _bounded_step(rest.T @ rest + held, -scaled[mine].T @ residual[mine], low, high)
        found[mine] = residual[mine] + scaled[mine] @ moved
    return found


def _bounded_step(normal: np.ndarray, slope: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the step (p,) of least squares; parameters that would leave their bounds stop there, one set at a time."""
    step, held = np.zeros(len(slope)), np.zeros(len(slope), dtype=bool)
    for _ in range(len(slope)):
        free = ~held
        push = slope[free] + normal[np.ix_(free, held)] @ step[held]
        step[free] = -np.linalg.pinv(normal[np.ix_(free, free)], rcond=UNSEEN, hermitian=True) @ push
        outside = free & ((step < low) | (step > high))
        step = np.clip(step, low, high)
        if not outside.any():
            break
        held |= outside
    return step
