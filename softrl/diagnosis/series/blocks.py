"""How long neighbouring samples of a series depend on each other, and means over blocks that hardly do."""

import numpy as np
from scipy import stats

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


def expanded(confidence: float, blocks: np.ndarray) -> float:
    """Return the level whose quantile of bootstrap means over ``blocks`` (steps,) bounds the mean with ``confidence``.

    Notes
    -----
    Means of few blocks spread too little, and how much they do is itself uncertain: the expanded percentile interval
    (Hesterberg 2015, The American Statistician 69, 371) takes Student's quantile for the normal one. Of one block nothing is
    known, and the farthest mean is returned.
    """
    count = int(blocks.max()) + 1
    if count < 2:
        return 1.0
    return float(stats.norm.cdf(np.sqrt(count / (count - 1)) * stats.t.ppf(confidence, count - 1)))
