"""How long a time step may be: a slow robot needs no short ones, and with longer ones fits see more of the recordings.

Steps go into the time between rows without rest where they are shorter: a command that changed within one would act with its mean
over all of it, and a valve of limited flow, which takes what is asked for as a whole, stays wrong by that as long as it fills.
"""

from dataclasses import replace

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.problem import Numerics, Problem
from softrl.pcc.simulator import PccSimulator

LONGER = 2.0  # times the configured step, at most, where parameters are fitted; ``bin_s / 2`` where effects are ranked
FITTED_SHARE = 0.3  # of the smallest difference that counts: what the longer step may change
RANKED_SHARE = 1.0
ROUNDED = 0.1  # of a step: rows' times are rounded, and a step may be as much longer than told
EVEN, NEARLY_ALL = 0.02, 0.9  # share of the rows' time apart by which that may differ, of so many of them


def suited(problem: Problem, material: float) -> Numerics:
    """Return the problem's numerics with the longest steps that change the body's motion by less than counts.

    Parameters
    ----------
    problem : the body alone, on recordings
    material : the smallest difference that counts, m

    Notes
    -----
    How large the steps' own error is shows on the body without effects, which is the fastest (lags, creep and friction only
    slow it down), and, of a lumped one, on the body with a typical payload, which swings more. A reduced body is not asked
    under a load that its samples may not hold.
    """
    period_s, told = _period(problem), problem.numerics
    numerics = replace(told, dt_s=within_rows(told.dt_s, period_s), rough_dt_s=within_rows(told.rough_dt_s, period_s))
    tried = _tried(replace(problem, numerics=numerics))

    def allowed(step: float, share: float) -> bool:
        coarser = replace(problem, numerics=replace(numerics, dt_s=step))
        try:
            apart = [_motion(coarser, load) - motion for load, motion in tried.items()]
        except SolverError:
            return False
        return max(np.sqrt(np.mean(np.sum(moved**2, axis=1))) for moved in apart) <= share * material

    fitted, ranked = (within_rows(step, period_s) for step in (LONGER * told.dt_s, 0.5 * told.bin_s))
    dt_s = fitted if fitted <= ranked and allowed(fitted, FITTED_SHARE) else numerics.dt_s
    rough_dt_s = ranked if ranked > numerics.rough_dt_s and allowed(ranked, RANKED_SHARE) else numerics.rough_dt_s
    return replace(numerics, dt_s=dt_s, rough_dt_s=max(rough_dt_s, dt_s))


def within_rows(step_s: float, period_s: float) -> float:
    """Return the longest step, ``step_s`` or less, of which whole ones make ``period_s``; ``step_s`` where that is longer."""
    if step_s >= period_s:
        return step_s
    within = float(period_s / np.ceil(period_s / step_s - ROUNDED))
    return step_s if np.isclose(within, step_s, rtol=1e-6) else within


def _period(problem: Problem) -> float:
    """Return how far rows are apart, s, or 0 where that is uneven."""
    apart = np.concatenate([np.diff(run.time) for run in problem.runs])
    period_s = float(np.median(apart))
    return period_s if np.quantile(np.abs(apart - period_s), NEARLY_ALL) < EVEN * period_s else 0.0


def _tried(problem: Problem) -> dict[tuple[Choice, ...], np.ndarray]:
    """Return how the body moves under what it is tried with: nothing, and a load if it can bear one."""
    load, bare = (Choice("payload"),), _motion(problem, ())
    if not isinstance(problem.simulator, PccSimulator):
        return {(): bare}
    try:
        return {(): bare, load: _motion(problem, load)}
    except SolverError:
        return {(): bare}


def _motion(problem: Problem, load: tuple[Choice, ...]) -> np.ndarray:
    """Return what the body does under a ``load``, less what was measured (bins, channels), runs joined."""
    point = np.concatenate([np.zeros(0), *(starts(choice)[0] for choice in load)])
    return np.concatenate(problem.residual(Hypothesis(load, ()), point).runs)
