"""Tests and intervals for series whose neighbouring samples depend on each other."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

UNSEEN = 1e-6  # eigenvalue of the normalised normal matrix below which a direction counts as unseen
LINE_WIDTH = 8  # frequencies either side that a line is compared with
MIN_BLOCKS = 6  # fewer independent blocks say nothing about a spread


def correlation_time(series: np.ndarray) -> float:
    """Return the integrated autocorrelation time of ``series`` (steps,) in samples, at least 1.

    Notes
    -----
    ``1 + 2 sum rho_k`` up to the first lag with ``rho_k + rho_(k+1) <= 0`` (initial positive sequence of Markov
    chain practice; no equation number checked).
    """
    centred = series - series.mean()
    power = float(centred @ centred)
    if len(series) < 4 or power <= 0.0:
        return 1.0
    size = 1 << (2 * len(series) - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(centred, size)) ** 2
    rho = np.fft.irfft(spectrum, size)[: len(series) // 2] / power
    pairs = rho[1:-1:2] + rho[2::2]
    stop = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else len(pairs)
    return float(max(1.0, 1.0 + 2.0 * pairs[:stop].sum()))


def blocks_of(runs: np.ndarray, length: int) -> np.ndarray:
    """Return a block number (steps,) for samples that belong to ``runs`` (steps,): ``length`` samples of one run each.

    A remainder shorter than half a block joins the block before it.
    """
    number = np.empty(len(runs), dtype=int)
    first = 0
    for run in dict.fromkeys(runs.tolist()):
        mine = np.flatnonzero(runs == run)
        count = max(round(len(mine) / length), 1)
        number[mine] = first + np.minimum(np.arange(len(mine)) * count // len(mine), count - 1)
        first += count
    return number


def block_sums(values: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Return the sums (blocks, ...) of ``values`` (steps, ...) over each block."""
    sums = np.zeros((int(blocks.max()) + 1, *values.shape[1:]))
    np.add.at(sums, blocks, values)
    return sums


def bootstrap_means(values: np.ndarray, blocks: np.ndarray, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Return ``draws`` means of ``values`` (steps,) over blocks drawn with replacement."""
    sums = block_sums(values, blocks)
    counts = np.bincount(blocks, minlength=len(sums)).astype(float)
    chosen = rng.integers(0, len(sums), (draws, len(sums)))
    return np.asarray(sums[chosen].sum(axis=1) / counts[chosen].sum(axis=1))


def holm(p_values: Sequence[float]) -> np.ndarray:
    """Return p-values corrected for their number after Holm: the chance of any false alarm stays at the level."""
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p)
    stepped = np.maximum.accumulate((len(p) - np.arange(len(p))) * p[order])
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(stepped, 1.0)
    return corrected


def whiteness(series: np.ndarray, lags: int) -> tuple[float, float]:
    """Return (portmanteau statistic, p-value) against white noise of ``series`` (steps,).

    Notes
    -----
    Ljung and Box's statistic over ``lags`` autocorrelations (textbook form, no equation number checked).
    """
    n = len(series)
    centred = series - series.mean()
    power = float(centred @ centred)
    if power <= 0.0 or n <= lags + 2:
        return 0.0, 1.0
    rho = np.array([centred[k:] @ centred[:-k] for k in range(1, lags + 1)]) / power
    statistic = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
    return statistic, float(stats.chi2.sf(statistic, lags))


def slope_test(target: np.ndarray, regressor: np.ndarray, blocks: np.ndarray) -> tuple[float, float]:
    """Return (correlation, p-value) of ``target`` (steps,) with ``regressor`` (steps,), robust within blocks.

    Notes
    -----
    Least-squares slope with a covariance clustered by blocks and Student's t with blocks - 2 degrees of freedom, so
    that samples of one block may depend on each other in any way.
    """
    x, y = regressor - regressor.mean(), target - target.mean()
    blocks = np.unique(blocks, return_inverse=True)[1]
    count = int(blocks.max()) + 1
    power = float(x @ x)
    if count < MIN_BLOCKS or power <= 0.0 or not y.any():
        return 0.0, 1.0
    slope = float(x @ y) / power
    score = block_sums(x * (y - slope * x), blocks)
    spread = np.sqrt(count / (count - 1) * float(score @ score)) / power
    p_value = float(2.0 * stats.t.sf(abs(slope) / max(spread, 1e-300), count - 2))
    return slope * float(np.sqrt(power / (y @ y))), p_value


def sandwich(jacobian: np.ndarray, residual: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Return the covariance (p, p) of least-squares parameters, robust to dependence within blocks.

    Parameters
    ----------
    jacobian : (rows, p)
    residual : (rows,)
    blocks : (rows,) block number of every row
    """
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
    ``-(H - H_k)^-1 (g - g_k)``. Directions that the other folds do not see stay where they are.
    """
    if not jacobian.size:
        return residual
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    scaled = jacobian / size
    count = int(folds.max()) + 1
    normal = [scaled[folds == k].T @ scaled[folds == k] for k in range(count)]
    slope = [scaled[folds == k].T @ residual[folds == k] for k in range(count)]
    found = residual.copy()
    for k in range(count):
        mine = folds == k
        rest, push = sum(normal) - normal[k], sum(slope) - slope[k]
        moved = -np.linalg.pinv(rest, rcond=UNSEEN, hermitian=True) @ push
        moved = np.clip(moved, low * size, high * size)
        found[mine] = residual[mine] + scaled[mine] @ moved
    return found


def spectral_line(runs: Sequence[np.ndarray]) -> float:
    """Return the chance that noise with a smooth spectrum shows a peak as high as the highest in ``runs`` (steps, n).

    Notes
    -----
    Each periodogram, summed over channels along the direction of largest power, is divided by its running median over
    ``LINE_WIDTH`` frequencies; about a smooth spectrum the ratio is exponential, and the chance is corrected for the
    number of frequencies looked at and runs (textbook form, no equation number checked).
    """
    chances, count = [1.0], 0
    for run in runs:
        centred = run - run.mean(axis=0)
        main = centred @ np.linalg.svd(centred.T @ centred)[0][:, 0]
        power = np.abs(np.fft.rfft(main * np.hanning(len(main)))) ** 2
        if len(power) < 2 * LINE_WIDTH:
            continue
        around = np.array([np.median(power[max(k - LINE_WIDTH, 1) : k + LINE_WIDTH]) for k in range(len(power))])
        ratio = power[2:] / np.maximum(around[2:] / np.log(2.0), 1e-300)
        chances.append(float(np.exp(-min(ratio.max(), 700.0))))
        count += len(ratio)
    return min(1.0, min(chances) * max(count, 1))
