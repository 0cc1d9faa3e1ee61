"""What comes at a few moments only and is none of the noise of the rest: a valve that sticks, a hose that catches."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from softrl.diagnosis.series.noise import centred, innovations, tells

NOTHING = 1e-6  # of the largest variance: a direction with less is none


def at_moments(runs: Sequence[np.ndarray], level: float) -> float:
    """Return the share of the power of ``runs`` (steps, n) at moments which stand out so far that noise never does.

    Parameters
    ----------
    runs : series whose noise may have a memory, and be louder in one run than in another
    level : chance that in noise any moment of all runs stands out

    Notes
    -----
    A moment's size is the squared innovation of an autoregression fitted to the runs, beside the median of all, which a few
    moments do not move. In Gaussian noise it is chi-squared, with a degree of freedom for each direction in which a run has
    any; the level is divided by the number of moments. A fit that is a little off leaves something wherever the robot moves,
    which raises the median as well. Runs of a few rows tell no spread, and do not count.
    """
    runs, memories = centred(runs)
    news = [innovations(run, memories) for run in runs if tells(run, memories)]
    if not news:
        return 0.0
    power = np.concatenate([np.sum(new**2, axis=1) for new in news])
    apart = [_independent(new) for new in news]
    freedom = np.concatenate([np.full(len(new), max(new.shape[1], 1)) for new in apart])
    sizes = np.concatenate([np.sum(new**2, axis=1) for new in apart])
    usual = max(float(np.median(sizes / stats.chi2.median(freedom))), 1e-300)
    rare = sizes > usual * stats.chi2.isf(level / len(sizes), freedom)
    return float(power[rare].sum() / max(float(power.sum()), 1e-300))


def _independent(new: np.ndarray) -> np.ndarray:
    """Return ``new`` (steps, n) turned and scaled so that its channels (steps, m <= n) are independent and alike.

    Directions in which there is nothing, as across the plane of a planar robot, are left out.
    """
    new = new - new.mean(axis=0)
    seen, basis = np.linalg.eigh(new.T @ new / len(new))
    there = seen > NOTHING * max(float(seen[-1]), 1e-300)
    return np.asarray(new @ basis[:, there] / np.sqrt(seen[there]))
