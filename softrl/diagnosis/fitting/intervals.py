"""How certain the parameters of a fit are: errors that stay alike, what is pinned, the body's form, the time step."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.form import Freed, freed, taken_up, weight_error
from softrl.diagnosis.fitting.hypothesis import LASTING, MOMENTS, Choice, Hypothesis, effect_axes
from softrl.diagnosis.fitting.judge import Thresholds
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial, columns_of
from softrl.diagnosis.series.blocks import MIN_BLOCKS, blocks_of, correlation_time
from softrl.diagnosis.series.least_squares import UNSEEN, jackknife, sandwich

AT_BOUND = 1e-3  # share of a range at whose ends a parameter is said to be at a bound
NEAR = 0.02  # scaled, at most: the first minute is not the beginning of ten hours
WIDER, WORSE = 0.02, 1.02  # first of steps, scaled, that double from where nothing changes; times the cost that is a change
POOLED = 0.25  # level of the test by which runs differ
ALONE = 0.98  # of the squared derivatives by a parameter: told by one fold
FORM_SHARE = 0.05  # of the residual; found on single hidden effects, each fitted by its own law


class Interval(NamedTuple):
    """A parameter's value and interval."""

    owner: str
    name: str
    unit: str
    value: float
    low: float
    high: float
    at_bound: bool


def intervals(problem: Problem, trial: Trial, thresholds: Thresholds, free: Freed | None = None) -> list[Interval]:
    """Return every free parameter with its interval, robust to errors that stay alike within blocks and within runs.

    ``free`` is what ``freed`` returns, where it is known.
    """
    space = problem.space(trial.hypothesis)
    jacobian, residual = trial.fit.jacobian, trial.fit.residual
    reach = _reach(problem, jacobian, residual, thresholds)
    free = free or freed(problem, trial)
    pinned = free.trial.fit.jacobian[:, free.pinned]
    if pinned.any():
        reach = np.maximum(reach, _with_pinned(problem, jacobian, pinned, residual, reach, thresholds))
    reach = np.hypot(reach, weight_error(problem, trial)) + _step_error(problem, trial)
    found, bounds, rows = [], space.bounds, _in_the_log(problem, trial)
    for k, axis in enumerate(space.axes):
        u = float(trial.fit.point[k])
        free = bool(trial.fit.jacobian[:, k].any()) and reach[k] < bounds[1][k] - bounds[0][k]
        low, high = (u - reach[k], u + reach[k]) if free else _flat(problem, trial, k)
        ends = sorted((axis.physical(float(low)), axis.physical(float(high))))
        value = axis.physical(u)
        down = float(np.hypot(value - min(ends[0], value), rows[k]))
        low, high = max(value - down, min(axis.low, value)), max(ends[1], value)
        if axis.is_direction:
            low, value, high = np.array([low, value, high]) - 2.0 * np.pi * round(value / (2.0 * np.pi))
        near = min(AT_BOUND * (bounds[1][k] - bounds[0][k]), NEAR)
        at_bound = bool(min(u - bounds[0][k], bounds[1][k] - u) < near)
        found.append(Interval(axis.owner, axis.name, axis.unit, value, low, high, at_bound))
    return found


def intervals_of_pinned(problem: Problem, trial: Trial, thresholds: Thresholds, all_free: Freed) -> dict[Choice, list[Interval]]:
    """Return, effect by effect, the pinned parameters with their intervals: about neutral, and where they would go if free.

    That a parameter does not pay does not mean that it is neutral. ``all_free`` is what ``freed`` returns.
    """
    free = all_free.trial
    if not all_free.pinned.any():
        return {}
    gone = free.fit.point + taken_up(free.fit.jacobian, free.fit.residual[:, None])[:, 0]
    found = []
    for axis, u, told in zip(problem.space(free.hypothesis).axes, gone, intervals(problem, free, thresholds), strict=True):
        there = axis.physical(float(u)) - told.value
        low, high = told.low + min(there, 0.0), told.high + max(there, 0.0)
        found.append(told._replace(low=max(low, min(axis.low, told.low)), high=min(high, max(axis.high, told.high))))
    by_choice = zip(trial.hypothesis.effects, by_effect(free.hypothesis, found).values(), strict=True)
    return {choice: [told for told in mine if told.name in choice.pinned] for choice, mine in by_choice}


def _in_the_log(problem: Problem, trial: Trial) -> np.ndarray:
    """Return how much (p,) s of a parameter may be that of the log: what shifts all in time holds how rows are written, too."""
    held = np.zeros(len(trial.fit.point))
    for choice in trial.hypothesis.effects:
        if choice.shifts_time:
            held[columns_of(trial, choice)[0]] = problem.late_max_s - problem.late_apart_s
    return held


def _flat(problem: Problem, trial: Trial, k: int) -> tuple[float, float]:
    """Return the scaled values of parameter ``k``, which has hardly any influence where it is, at which it begins to have one.

    A dead time between a quick valve and a slow log changes nothing until it reaches the next row, nor does a moment within a
    pause until it reaches a run: how long the pause was says nothing of how far into the run.
    """
    low, high = problem.space(trial.hypothesis).bounds
    down, up = _edges(problem, trial, k)
    return _end(problem, trial, k, float(low[k]), down[::-1]), _end(problem, trial, k, float(high[k]), up)


def _end(problem: Problem, trial: Trial, k: int, bound: float, edges: Sequence[float]) -> float:
    """Return the scaled value towards ``bound`` at which parameter ``k`` has an influence, or ``bound``.

    It is found to within its distance from the last of the ``edges``, in order, at which it has none.
    """
    begin = fine = float(trial.fit.point[k])
    worse = _first_worse(problem, trial, k, begin, bound)
    for edge in edges:
        if min(fine, worse) < edge < max(fine, worse):
            if _worse(problem, trial, _moved(trial, k, edge)):
                worse = edge
                break
            fine = edge
    return worse if fine == begin else _first_worse(problem, trial, k, fine, worse)


def _first_worse(problem: Problem, trial: Trial, k: int, begin: float, bound: float) -> float:
    """Return the first scaled value of parameter ``k`` with an influence, in steps from ``begin`` that double; or ``bound``."""
    step = WIDER
    while step < abs(bound - begin):
        value = begin + float(np.copysign(step, bound - begin))
        if _worse(problem, trial, _moved(trial, k, value)):
            return value
        step *= 2.0
    return bound


def _edges(problem: Problem, trial: Trial, k: int) -> tuple[list[float], list[float]]:
    """Return where runs end, and where they begin, in scaled units of a moment ``k`` that lasts; of what does not, none."""
    axis = problem.space(trial.hypothesis).axes[k]
    choice = next((choice for choice in trial.hypothesis.effects if k in columns_of(trial, choice)), None)
    if choice is None or not choice.lasting or axis.name not in MOMENTS:
        return [], []
    clock = ("", *LASTING).index(choice.lasting)
    spans = [(run.gone_s[clock], run.gone_s[clock] + float(np.ptp(run.time))) for run in problem.runs]
    return sorted(axis.scaled(end) for _, end in spans), sorted(axis.scaled(begin) for begin, _ in spans)


def _moved(trial: Trial, k: int, value: float) -> np.ndarray:
    point = trial.fit.point.copy()
    point[k] = value
    return point


def _worse(problem: Problem, trial: Trial, point: np.ndarray) -> bool:
    try:
        residual = problem.residual(trial.hypothesis, point, trial.placed).flat
    except SolverError:
        return True
    return 0.5 * float(residual @ residual) > WORSE * trial.fit.cost


def by_effect(hypothesis: Hypothesis, found: list[Interval]) -> dict[Choice, list[Interval]]:
    """Return the intervals of each effect's parameters."""
    left, sorted_out = list(found), {}
    for choice in hypothesis.effects:
        size = len(effect_axes(choice))
        sorted_out[choice], left = left[:size], left[size:]
    return sorted_out


def _reach(problem: Problem, jacobian: np.ndarray, residual: np.ndarray, thresholds: Thresholds) -> np.ndarray:
    """Return half the intervals (p,) of least-squares parameters, in scaled units."""
    rows = len(residual) // len(problem.run_of_bin)
    blocks = _independent(problem, residual.reshape(-1, rows), jacobian.shape[1], thresholds)
    spread = np.sqrt(np.diag(sandwich(jacobian, residual, np.repeat(blocks, rows))))
    freedom = max(int(blocks.max()) + 1 - len(spread), 1)
    folds = np.repeat(problem.folds, rows)
    once = _of_one_fold(jacobian, folds)  # no other fold moves it, nor by it what these tell
    apart = np.where(once, 0.0, jackknife(np.where(once, 0.0, jacobian), residual, folds))
    reach = half_width(spread, freedom, apart, int(problem.folds.max()), thresholds.confidence)
    return np.asarray(np.hypot(reach, _form_error(jacobian, residual)))


def half_width(within: np.ndarray, freedom: int, between: np.ndarray, apart: int, confidence: float) -> np.ndarray:
    """Return half the intervals (p,) by standard errors within runs and between them, each with its degrees of freedom.

    Few runs tell their own spread badly: the larger of two estimates of one error is too large. Both are pooled unless runs
    differ by more than blocks within them say, by an F test at the level of ``POOLED`` that is advised where a test decides on
    pooling (Bozivich, Bancroft and Hartley, Annals of Mathematical Statistics 27, 1956; the level as commonly quoted).
    """
    both = np.sqrt((freedom * within**2 + apart * between**2) / (freedom + apart))
    differ = between**2 > stats.f.ppf(1.0 - POOLED, apart, freedom) * within**2
    told = np.where(between > 0.0, both, within)  # 0: nearly one run alone tells, and no other could contradict it
    quantile, few = (float(stats.t.ppf(confidence, n)) for n in (freedom + apart, apart))
    return np.where(differ, np.maximum(few * between, quantile * told), quantile * told)


def _of_one_fold(jacobian: np.ndarray, folds: np.ndarray) -> np.ndarray:
    """Return which parameters (p,) nearly one fold alone tells, such as when something began: no other could contradict it."""
    size = np.stack([np.sum(jacobian[folds == fold] ** 2, axis=0) for fold in np.unique(folds)])
    return np.asarray(size.max(axis=0) > ALONE * size.sum(axis=0))


def _with_pinned(
    problem: Problem,
    jacobian: np.ndarray,
    pinned: np.ndarray,
    residual: np.ndarray,
    reach: np.ndarray,
    thresholds: Thresholds,
) -> np.ndarray:
    """Return half the intervals (p,) where pinned parameters, of derivatives (rows, q), may have other values as well.

    That the data cannot tell a parameter from its neutral value does not mean that it has it. It is not taken to be
    farther away than plain to see.
    """
    count, both = jacobian.shape[1], np.hstack([jacobian, pinned])
    moved = taken_up(both, residual[:, None])[:count, 0]
    freed = _reach(problem, both, residual, thresholds)[:count] + np.abs(moved)
    return np.asarray(np.minimum(freed, reach + np.abs(taken_up(jacobian, pinned)).sum(axis=1)))


def _independent(problem: Problem, residual: np.ndarray, free: int, thresholds: Thresholds) -> np.ndarray:
    """Return blocks (bins,) as long as errors (bins, channels) stay alike, but enough of them for ``free`` parameters."""
    runs = problem.run_of_bin
    longest = max(
        correlation_time(residual[runs == run, k]) for run in np.unique(runs) for k in range(residual.shape[1])
    )
    length = max(thresholds.block_s / problem.numerics.bin_s, 2.0 * longest)
    return blocks_of(runs, max(int(min(length, len(runs) / (MIN_BLOCKS + 2 * free))), 1))


def _form_error(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return how far the parameters (p,) may be off, in scaled units, because the body is not quite the robot's.

    What is left after the fit holds no part that a parameter could take; but what a body of another form would have left
    may have had one, alike in all runs, which no comparison of runs shows: ``FORM_SHARE`` of it.
    """
    free = jacobian.any(axis=0)
    size = np.linalg.norm(jacobian[:, free], axis=0)
    scaled = jacobian[:, free] / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=UNSEEN, hermitian=True)
    found = np.zeros(jacobian.shape[1])
    found[free] = FORM_SHARE * np.linalg.norm(residual) * np.sqrt(np.diag(inverse)) / size
    return found


def _step_error(problem: Problem, trial: Trial) -> np.ndarray:
    """Return how far the parameters (p,) move as the time step goes to zero, in scaled units.

    One Gauss-Newton step at half the time step, doubled: the integrators are of first order.
    """
    finer = replace(problem, numerics=replace(problem.numerics, dt_s=0.5 * problem.numerics.dt_s))
    try:
        residual = finer.residual(trial.hypothesis, trial.fit.point, trial.placed).flat
    except SolverError:
        return np.zeros(len(trial.fit.point))
    size = np.maximum(np.linalg.norm(trial.fit.jacobian, axis=0), 1e-300)
    scaled = trial.fit.jacobian / size
    moved = np.linalg.solve(scaled.T @ scaled + 1e-6 * np.eye(len(size)), scaled.T @ (residual - trial.fit.residual))
    return np.asarray(np.minimum(2.0 * np.abs(moved / size), 1.0))
