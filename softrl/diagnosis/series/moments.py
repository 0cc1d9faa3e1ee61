"""What comes at a few moments only and is none of the noise of the rest: a valve that sticks, a hose that catches."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from softrl.diagnosis.series.noise import autoregression, innovations


def at_moments(runs: Sequence[np.ndarray], level: float) -> float:
    """Return the share of the power of ``runs`` (steps, n) at moments which stand out so far that noise never does.

    Parameters
    ----------
    runs : series whose noise may have a memory, and be louder in one run than in another
    level : chance that in noise any moment of all runs stands out

    Notes
    -----
    A moment's size is the squared innovation of an autoregression fitted to the runs, beside the median of all, which a few
    moments do not move. In Gaussian noise it is chi-squared; the level is divided by the number of moments. A fit that is a
    little off leaves something wherever the robot moves, which raises the median as well.
    """
    runs = [run - run.mean(axis=0) for run in runs]
    memories = [autoregression([run[:, k] for run in runs]) for k in range(runs[0].shape[1])]
    news = [innovations(run, memories) for run in runs]
    power = np.concatenate([np.sum(new**2, axis=1) for new in news])
    sizes = _beside_median(np.concatenate([_independent(new) for new in news]))
    largest = stats.chi2.isf(level / len(sizes), runs[0].shape[1])
    return float(power[sizes > largest].sum() / max(float(power.sum()), 1e-300))


def _independent(new: np.ndarray) -> np.ndarray:
    """Return ``new`` (steps, n) turned and scaled so that its channels are independent and alike."""
    new = new - new.mean(axis=0)
    seen, basis = np.linalg.eigh(new.T @ new / len(new))
    return np.asarray(new @ basis / np.sqrt(np.maximum(seen, 1e-12 * max(float(seen[-1]), 1e-300))))


def _beside_median(series: np.ndarray) -> np.ndarray:
    """Return the squares (steps,) of ``series`` (steps, n) in units in which Gaussian noise has the median of chi-squared."""
    square = np.sum(series**2, axis=1)
    return np.asarray(square * stats.chi2.median(series.shape[1]) / max(float(np.median(square)), 1e-300))
