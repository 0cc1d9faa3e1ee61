"""How long a time step may be: a slow robot needs no short ones, and with longer ones fits see more of the recordings."""

from dataclasses import replace

import numpy as np

from softrl.diagnosis.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.problem import Numerics, Problem
from softrl.pcc.simulator import PccSimulator

LONGER = 2.0  # times the configured step, at most, where parameters are fitted; ``bin_s / 2`` where effects are ranked
FITTED_SHARE = 0.3  # of the smallest difference that counts: what the longer step may change
RANKED_SHARE = 1.0


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
    numerics = problem.numerics
    reference = _motions(problem)

    def allowed(step: float, share: float) -> bool:
        coarse = _motions(replace(problem, numerics=replace(numerics, dt_s=step)))
        apart = [np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))) for a, b in zip(coarse, reference, strict=True)]
        return max(apart) <= share * material

    fitted, ranked = LONGER * numerics.dt_s, 0.5 * numerics.bin_s
    dt_s = fitted if fitted <= ranked and allowed(fitted, FITTED_SHARE) else numerics.dt_s
    rough_dt_s = ranked if ranked > numerics.rough_dt_s and allowed(ranked, RANKED_SHARE) else numerics.rough_dt_s
    return replace(numerics, dt_s=dt_s, rough_dt_s=max(rough_dt_s, dt_s))


def _motions(problem: Problem) -> list[np.ndarray]:
    """Return what the body does, less what was measured (bins, channels), runs joined: alone, and with a load."""
    load, tried = Choice("payload"), [(Hypothesis((), ()), np.zeros(0))]
    if isinstance(problem.simulator, PccSimulator):
        tried.append((Hypothesis((load,), ()), starts(load)[0]))
    return [np.concatenate(problem.residual(hypothesis, at).runs) for hypothesis, at in tried]
