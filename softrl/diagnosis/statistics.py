"""Tests and intervals for series whose neighbouring samples depend on each other."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

UNSEEN = 1e-6  # eigenvalue of the normalised normal matrix below which a direction counts as unseen
AT_END = 1e-6  # scaled distance from a bound below which a parameter sits on it
MIN_FREQUENCIES = 32  # fewer do not show whether a spectrum is smooth
DRIVEN_LEVEL = 1e-3  # chance of a peak in a drive's spectrum that marks a frequency as driven
EULER = 0.5772  # mean of minus the logarithm of an exponential variable
MAX_ORDER = 8  # of an autoregression
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


def spectral_line(runs: Sequence[np.ndarray], drives: Sequence[np.ndarray]) -> float:
    """Return the chance that noise with a smooth spectrum shows a peak as high as the highest in ``runs`` (steps, n).

    Frequencies at which the ``drives`` (steps, m) of the same runs swing themselves are left out.

    Notes
    -----
    The logarithm of each periodogram, along the direction of largest power, is fitted by a cubic in the logarithm of
    the frequency; about a smooth spectrum the ratio to it is exponential. The chance is corrected for the number of
    frequencies and runs looked at (textbook form, no equation number checked).
    """
    chances, count = [1.0], 0
    for run, drive in zip(runs, drives, strict=True):
        if len(run) // 2 - 2 < MIN_FREQUENCIES:
            continue
        centred = run - run.mean(axis=0)
        height = _above_smooth(centred @ np.linalg.svd(centred.T @ centred)[0][:, 0])
        driven = np.zeros(len(height), dtype=bool)
        for pressure in drive.T:
            if np.ptp(pressure) > 0.0:
                driven |= _above_smooth(pressure - pressure.mean()) > np.log(-np.log(DRIVEN_LEVEL))
        height = height[~(driven | np.roll(driven, 1) | np.roll(driven, -1))]
        if len(height):
            chances.append(float(np.exp(-np.exp(min(float(height.max()), 6.0)))))
            count += len(height)
    return min(1.0, min(chances) * max(count, 1))


def _above_smooth(series: np.ndarray) -> np.ndarray:
    """Return the logarithm (frequencies,) of the periodogram of ``series`` (steps,) over a smooth one."""
    power = np.maximum(np.abs(np.fft.rfft(series * np.hanning(len(series)))[2:-1]) ** 2, 1e-300)
    place = np.log(np.arange(2, len(power) + 2))
    smooth = np.polynomial.Polynomial.fit(place, np.log(power), 3, w=np.sqrt(1.0 / np.arange(2, len(power) + 2)))
    return np.asarray(np.log(power) - smooth(place) - EULER)


class Uneven(NamedTuple):
    """How unlike noise a series is: the chance of it in noise, and the share of its power that is in excess.

    In excess of what its quiet samples have, or of what it has where the drives rest, whichever is more.
    """

    p_value: float
    share: float


def unlike_noise(
    runs: Sequence[np.ndarray],
    drives: Sequence[np.ndarray],
    draws: int,
    rng: np.random.Generator,
    slopes: Sequence[np.ndarray] = (),
) -> Uneven:
    """Return how uneven ``runs`` (steps, n) are under ``drives`` (steps, m), beside noise of the same memory.

    Uneven in two ways: their innovations have heavy tails, as after jumps, or are larger where the drives move. What
    parameters with the derivatives ``slopes`` (steps, n, p) could take up counts as neither: a fit to noise leaves them a
    little off, and what that does is sharp where the drives move.

    Notes
    -----
    Innovations are those of an autoregression fitted to the runs, compared with Gaussian ones of the same correlations
    between channels. Of ``n`` Gaussian channels the median of the summed squares is that of chi-squared with ``n`` degrees
    of freedom (textbook form, no equation number checked). A small chance says that there is structure, not that it is
    large: every simulator's body leaves some, which the share tells.
    """
    runs = [run - run.mean(axis=0) for run in runs]
    memories = [autoregression([run[:, k] for run in runs]) for k in range(runs[0].shape[1])]
    active = [np.abs(np.diff(drive, axis=0, prepend=drive[:1])).sum(axis=1) for drive in drives]
    news = [_innovations(run, memories) for run in runs]
    moves = np.concatenate([move[-len(new) :] for move, new in zip(active, news, strict=True)])
    size = np.concatenate([np.broadcast_to(np.maximum(new.std(axis=0), 1e-150), new.shape) for new in news])
    ends = np.cumsum([len(new) for new in news])[:-1]
    taken = _taken_up([_innovations(slope, memories) for slope in slopes], size)

    def squares(new: np.ndarray) -> np.ndarray:
        new = new - (taken @ (taken.T @ new.ravel())).reshape(new.shape)
        parts = np.split(new, ends)
        return np.concatenate([(x - x.mean(axis=0)) ** 2 / np.maximum(x.var(axis=0), 1e-300) for x in parts])

    def uneven(square: np.ndarray) -> np.ndarray:
        power = np.sqrt(square.sum(axis=1))
        slope = np.corrcoef(moves, power)[0, 1] if np.ptp(moves) > 0.0 and np.ptp(power) > 0.0 else 0.0
        return np.array([np.mean(square**2), slope])

    new = np.concatenate(news) / size
    found = squares(new)
    seen, basis = np.linalg.eigh(new.T @ new / len(new))
    mix = (basis * np.sqrt(np.maximum(seen, 0.0))).T
    drawn = np.array([uneven(squares(rng.standard_normal(new.shape) @ mix)) for _ in range(draws)])
    ranks = (1.0 + np.sum(drawn >= uneven(found), axis=0)) / (draws + 1.0)
    return Uneven(float(min(1.0, len(ranks) * ranks.min())), _in_excess(found, moves))


def _in_excess(square: np.ndarray, moves: np.ndarray) -> float:
    """Return the share of the power of ``square`` (steps, n) beyond that of quiet samples, or of no ``moves`` (steps,)."""
    channels, power = square.shape[1], square.sum(axis=1)
    quiet = float(np.median(power)) * channels / float(stats.chi2.median(channels))
    change = moves - moves.mean()
    slope = max(float(change @ power) / max(float(change @ change), 1e-300), 0.0)
    rest = min(quiet, float(power.mean() - slope * moves.mean()))
    return float(np.clip(1.0 - rest / max(float(power.mean()), 1e-300), 0.0, 1.0))


def _innovations(run: np.ndarray, memories: Sequence[np.ndarray]) -> np.ndarray:
    """Return ``run`` (steps, n, ...) less what each channel's memory predicts; equally many first samples left out."""
    longest = max(len(memory) for memory in memories)
    whole = [whitened(run[:, k], memory) for k, memory in enumerate(memories)]
    return np.stack([column[longest - len(m) :] for column, m in zip(whole, memories, strict=True)], axis=1)


def _taken_up(slopes: Sequence[np.ndarray], size: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (rows, q) of what parameters with derivatives ``slopes`` (steps, n, p) can do."""
    if not slopes:
        return np.zeros((size.size, 0))
    columns = (np.concatenate(list(slopes)) / size[:, :, None]).reshape(size.size, -1)
    columns = columns[:, columns.any(axis=0)]
    basis, seen, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
    return np.asarray(basis[:, seen > UNSEEN])


def follows(target: Sequence[np.ndarray], regressor: Sequence[np.ndarray], length: int) -> tuple[float, float]:
    """Return (correlation, p-value) of series with a regressor, runs of (steps,) each.

    Notes
    -----
    Both are whitened by an autoregression fitted to the target, so that noise with a memory does not seem to follow a
    slow regressor; then ``slope_test`` in blocks of ``length`` samples (feasible generalised least squares, textbook
    form, no equation number checked).
    """
    centred = [y - y.mean() for y in target]
    memory = autoregression(centred)
    level = float(np.concatenate(list(regressor)).mean())
    white = [whitened(y, memory) for y in centred]
    drive = [whitened(x - level, memory) for x in regressor]
    runs = np.repeat(np.arange(len(white)), [len(y) for y in white])
    _, p_value = slope_test(np.concatenate(white), np.concatenate(drive), blocks_of(runs, length))
    y, x = np.concatenate(centred), np.concatenate([x - level for x in regressor])
    size = float(x @ y) / max(float(np.linalg.norm(x) * np.linalg.norm(y)), 1e-300)
    return size, p_value


def autoregression(runs: Sequence[np.ndarray]) -> np.ndarray:
    """Return the coefficients (order,) of the series' own past, the order chosen by Schwarz's criterion."""
    count = sum(max(len(run) - MAX_ORDER, 0) for run in runs)
    if count < 4 * MAX_ORDER:
        return np.zeros(0)
    past = [
        np.stack([run[MAX_ORDER - k : len(run) - k] for k in range(1, MAX_ORDER + 1)], axis=1)
        for run in runs
        if len(run) > MAX_ORDER
    ]
    x, y = np.concatenate(past), np.concatenate([run[MAX_ORDER:] for run in runs if len(run) > MAX_ORDER])
    best: tuple[float, np.ndarray] = (count * np.log(max(float(y @ y) / count, 1e-300)), np.zeros(0))
    for order in range(1, MAX_ORDER + 1):
        found = np.linalg.lstsq(x[:, :order], y, rcond=None)[0]
        left = y - x[:, :order] @ found
        score = count * np.log(max(float(left @ left) / count, 1e-300)) + order * np.log(count)
        if score < best[0]:
            best = (score, found)
    return best[1]


def whitened(series: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """Return ``series`` (steps,) less what ``memory`` predicts from its past; the first samples are left out."""
    left = series[len(memory) :].copy()
    for k, share in enumerate(memory, start=1):
        left -= share * series[len(memory) - k : len(series) - k]
    return left
