"""Maps without physics from pressures to motion or to a residual: a static one, and one with memory, by ridge regression.

They serve as competitors of equal data, and as the offered correction where no physics is found. They are never called
physics: what they say holds where they were trained.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter, lfiltic

from softrl.diagnosis.fitting.problem import Problem

MEMORY_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)  # time constants of the lagged pressures that stand for memory
FILTERS_S, CURVED = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0), (0, 2, 4)  # those of a black box, and which enter with their products, too
BRIEF_S = 1.0
STATIC_DEGREES = (1, 2, 3, 4)
BRIEF_DEGREES = (1, 2, 3)
MEMORY_DEGREES = (1, 2)
RIDGES = tuple(10.0**k for k in range(-6, 4))  # of the mean square of a standardised feature


class Features(NamedTuple):
    """Rows of features, one array (bins, n) a run."""

    runs: list[np.ndarray]


@dataclass(frozen=True)
class Ridge:
    """A polynomial in standardised features with shrunken coefficients.

    Attributes
    ----------
    degree : of the polynomial
    mean, spread : (n,) of the features on training runs
    weights : (terms, channels)
    level : (channels,) mean of the target
    """

    degree: int
    mean: np.ndarray
    spread: np.ndarray
    weights: np.ndarray
    level: np.ndarray

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Return (rows, channels), the features held within four spreads of their mean in training."""
        return np.asarray(_terms((features - self.mean) / self.spread, self.degree) @ self.weights + self.level)


def brief_features(problem: Problem) -> Features:
    """Return driving pressures and their lagged values at one time constant: memory for short recordings."""
    found = []
    for k in range(len(problem.runs)):
        bins, p = _in_time(problem, k)
        found.append(np.hstack([p, _lagged(p, problem.numerics.bin_s, BRIEF_S)])[bins])
    return Features(found)


def static_features(problem: Problem) -> Features:
    """Return the driving pressures of every bin."""
    return Features([pressures(problem, k) for k in range(len(problem.runs))])


def memory_features(problem: Problem) -> Features:
    """Return driving pressures, their lagged values, their largest sizes so far, and the time since the start."""
    found = []
    for k in range(len(problem.runs)):
        bins, p = _in_time(problem, k)
        clock = problem.numerics.bin_s * np.arange(len(p))[:, None]
        lagged = [_lagged(p, problem.numerics.bin_s, tau) for tau in MEMORY_S]
        found.append(np.hstack([p, *lagged, np.maximum.accumulate(np.abs(p), axis=0), clock])[bins])
    return Features(found)


def filtered_features(problem: Problem) -> Features:
    """Return driving pressures, what filters make of them, and products of some of these: all stay in the range of training."""
    found = []
    for k in range(len(problem.runs)):
        bins, p = _in_time(problem, k)
        lagged = [_lagged(p, problem.numerics.bin_s, tau) for tau in FILTERS_S]
        some = np.hstack([lagged[i] for i in CURVED])
        first, second = np.triu_indices(some.shape[1])
        found.append(np.hstack([p, *lagged, some[:, first] * some[:, second]])[bins])
    return Features(found)


def pressures(problem: Problem, number: int) -> np.ndarray:
    """Return the driving pressures (bins, chambers) of a run, in shares of the robot's largest."""
    run = problem.runs[number]
    acting = run.pressure_meas if problem.drive == "measured" and run.pressure_meas is not None else run.pressure_cmd
    return problem.binned(number, acting) / problem.robot.largest_pa


def _in_time(problem: Problem, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (bins,) of a run's bins among those of its whole time, and the pressures of all of those.

    Where a pause left bins without samples the pressures are taken to change evenly.
    """
    place = problem.bins[number].places
    every = np.arange(place[-1] + 1)
    known = pressures(problem, number)
    return place, np.stack([np.interp(every, place, column) for column in known.T], axis=1)


def _lagged(values: np.ndarray, period: float, tau: float) -> np.ndarray:
    """Return ``values`` (bins, n) behind a first-order lag, settled at the first row."""
    keep = float(np.exp(-period / tau))
    columns = []
    for column in values.T:
        start = lfiltic([1.0 - keep], [1.0, -keep], [column[0]])
        columns.append(lfilter([1.0 - keep], [1.0, -keep], column, zi=start)[0])
    return np.stack(columns, axis=1)


Kind = tuple[Callable[[Problem], Features], Sequence[int]]
STATIC: Kind = (static_features, STATIC_DEGREES)
KINDS: tuple[Kind, ...] = (STATIC, (brief_features, BRIEF_DEGREES), (memory_features, MEMORY_DEGREES))
BOXES: tuple[Kind, ...] = (*KINDS, (filtered_features, (1,)))  # a black box is the best of these


def correction(training: Problem, targets: Sequence[np.ndarray], other: Problem) -> list[np.ndarray]:
    """Return (bins, channels) a run of ``other``: what the best of all kinds of maps, fitted to ``targets``, predicts."""
    return best_map(training, targets, KINDS)(other)


def best_map(
    training: Problem, targets: Sequence[np.ndarray], kinds: Sequence[Kind]
) -> Callable[[Problem], list[np.ndarray]]:
    """Return what predicts (bins, channels) a run: of ``kinds`` the map that predicts folds left out best, see ``_chosen``."""
    found = [(features, *_chosen(features(training), targets, training.folds, degrees)) for features, degrees in kinds]
    features, ridge, _ = min(found, key=lambda one: one[2])
    return lambda other: [ridge.predict(rows) for rows in features(other).runs]


def _chosen(
    features: Features, targets: Sequence[np.ndarray], folds: np.ndarray, degrees: Sequence[int]
) -> tuple[Ridge, float]:
    """Return the map whose degree and shrinkage predict folds left out best, and its mean squared error there.

    Parameters
    ----------
    features, targets : of the training runs
    folds : (bins,) fold of every row, runs joined
    degrees : to choose from
    """
    x, y = np.concatenate(features.runs), np.concatenate(list(targets))
    mean, spread = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-9)
    level = y.mean(axis=0)
    best: tuple[float, int, float] = (np.inf, degrees[0], RIDGES[-1])
    for degree in degrees:
        terms = _terms((x - mean) / spread, degree)
        for ridge, error in zip(RIDGES, _left_out_errors(terms, y - level, folds), strict=True):
            best = min(best, (error, degree, ridge))
    error, degree, ridge = best
    terms = _terms((x - mean) / spread, degree)
    normal = terms.T @ terms + ridge * len(terms) * np.eye(terms.shape[1])
    return Ridge(degree, mean, spread, np.linalg.solve(normal, terms.T @ (y - level)), level), error


def _left_out_errors(terms: np.ndarray, target: np.ndarray, folds: np.ndarray) -> list[float]:
    """Return the mean squared error on folds left out, for every entry of ``RIDGES``."""
    errors = np.zeros(len(RIDGES))
    whole, push = terms.T @ terms, terms.T @ target
    for fold in np.unique(folds):
        mine = folds == fold
        seen, basis = np.linalg.eigh(whole - terms[mine].T @ terms[mine])
        turned = basis.T @ (push - terms[mine].T @ target[mine])
        shown = terms[mine] @ basis
        for k, ridge in enumerate(RIDGES):
            weights = turned / (np.maximum(seen, 0.0) + ridge * np.count_nonzero(~mine))[:, None]
            errors[k] += float(np.sum((target[mine] - shown @ weights) ** 2))
    return [float(e) / len(target) for e in errors]


def _terms(x: np.ndarray, degree: int) -> np.ndarray:
    """Return the monomials (rows, terms) of ``x`` (rows, n) from degree 1 to ``degree``."""
    x = np.clip(x, -4.0, 4.0)
    n = x.shape[1]
    parts, last = [x], [(x[:, i], i) for i in range(n)]
    for _ in range(degree - 1):
        last = [(column * x[:, j], j) for column, i in last for j in range(i, n)]
        parts.append(np.stack([column for column, _ in last], axis=1))
    return np.hstack(parts)
