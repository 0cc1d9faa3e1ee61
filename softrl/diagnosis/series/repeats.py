"""What is left wherever a pressure comes by, however finely it depends on it: coarse steps of a regulator, a kink."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.series.changing import Changing
from softrl.diagnosis.series.noise import apart, redrawn

LEVELS = 80  # into which the range of a pressure is cut
APART = 50  # steps of one part: only other parts tell what comes again


def repeats(
    runs: Sequence[np.ndarray], drives: Sequence[np.ndarray], draws: int, rng: np.random.Generator
) -> Changing:
    """Return how plainly ``runs`` (steps, n) are alike wherever one of the ``drives`` (steps, m) is.

    Notes
    -----
    Every sample is multiplied by the mean of those at the same level of a drive in other parts of the runs, ``APART`` steps
    long: the mean product is the power that comes again with that drive, and none in noise. A channel takes the drive with
    the most. The same is done with noise of the series' own spectrum, drawn anew channel by channel along axes on which
    they do not go together: a Monte Carlo test.
    """
    runs = apart(runs)
    whole, drive = float(np.sum(np.concatenate(runs) ** 2)), np.concatenate(drives)
    low, span = drive.min(axis=0), np.maximum(np.ptp(drive, axis=0), 1e-300)
    level = np.minimum((LEVELS * (drive - low) / span).astype(int), LEVELS - 1)
    own = np.unique(np.concatenate([[f"{k} {n // APART}" for n in range(len(run))] for k, run in enumerate(runs)]),
                    return_inverse=True)[1]  # fmt: skip
    cells = [own * LEVELS + column for column in level.T]
    seen = [np.bincount(cell, minlength=(own.max() + 1) * LEVELS).reshape(-1, LEVELS) for cell in cells]

    def again(series: np.ndarray) -> float:
        return sum(
            max(_power(column, cell, count) for cell, count in zip(cells, seen, strict=True)) for column in series.T
        )

    found = again(np.concatenate(runs))
    drawn = np.array([again(np.concatenate([redrawn(run, rng) for run in runs])) for _ in range(draws)])
    share = max(found - float(drawn.mean()), 0.0) / max(whole, 1e-300)
    return Changing(float((1.0 + np.sum(drawn >= found)) / (draws + 1.0)), min(share, 1.0))


def _power(series: np.ndarray, cell: np.ndarray, count: np.ndarray) -> float:
    """Return the sum of all samples (steps,) times the mean of those at the same level in other parts."""
    others = count.sum(axis=0) - count
    sums = np.bincount(cell, weights=series, minlength=count.size).reshape(count.shape)
    return float(np.sum(sums * (sums.sum(axis=0) - sums) / np.maximum(others, 1)))
