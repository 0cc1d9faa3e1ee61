"""Tests of series whose neighbouring samples depend on each other, and of many at once."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from softrl.diagnosis.series.blocks import MIN_BLOCKS, block_sums, blocks_of
from softrl.diagnosis.series.noise import autoregression, whitened


def holm(p_values: Sequence[float]) -> np.ndarray:
    """Return p-values corrected for their number after Holm: the chance of any false alarm stays at the level."""
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p)
    stepped = np.maximum.accumulate((len(p) - np.arange(len(p))) * p[order])
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(stepped, 1.0)
    return corrected


def slope_test(target: np.ndarray, regressor: np.ndarray, blocks: np.ndarray) -> tuple[float, float]:
    """Return (correlation, p-value) of ``target`` (steps,) with ``regressor`` (steps,), robust within blocks.

    Notes
    -----
    Least-squares slope with a covariance clustered by blocks, so that samples of one block may depend on each other in any
    way. Of a regressor that moves in a few blocks only these tell alone, and the slope follows them: each block's score is
    scaled by ``1 / sqrt(1 - h)``, h its share of the regressor's power, and Student's t has the degrees of freedom of that
    (Bell and McCaffrey, Survey Methodology 28, 2002, of one regressor; derived here, no equation number checked), less one
    for the mean: blocks - 2 where all tell alike. Fewer than ``MIN_BLOCKS`` blocks as effective as equal ones say nothing.
    """
    x, y = regressor - regressor.mean(), target - target.mean()
    blocks = np.unique(blocks, return_inverse=True)[1]
    power = float(x @ x)
    if power <= 0.0 or not y.any():
        return 0.0, 1.0
    share = block_sums(x**2, blocks) / power
    if float(share @ share) > 1.0 / MIN_BLOCKS:
        return 0.0, 1.0
    slope, rest = float(x @ y) / power, 1.0 - share
    score = block_sums(x * (y - slope * x), blocks) / np.sqrt(rest)
    spread = float(np.linalg.norm(score)) / power
    pull = share**2 / rest  # of the slope, which each block has a part in, on the others' scores
    freedom = 1.0 / float(share @ share + pull.sum() ** 2 - pull @ pull) - 1.0
    p_value = float(2.0 * stats.t.sf(abs(slope) / max(spread, 1e-300), freedom))
    return slope * float(np.sqrt(power / (y @ y))), p_value


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
