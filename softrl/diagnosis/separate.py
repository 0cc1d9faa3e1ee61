"""What to record next: the program under which hypotheses that fit alike would part most, beside the noise."""

from collections import Counter
from typing import Any

from softrl.core.errors import SolverError
from softrl.diagnosis.hypothesise import Trial
from softrl.diagnosis.problem import Problem
from softrl.excite.block import blocks
from softrl.excite.plan import Effort, Pair, plan, separation, sums
from softrl.excite.rival import Rival
from softrl.excite.separation import Sensing

MINUTES = 3.0
STEP_S = 0.02
REST_S = 2.0
EFFORT = Effort(shortlist=2, exchanges=0, fit_evaluations=1)


def separating_program(problem: Problem, first: Trial, second: Trial, noise_m: float) -> dict[str, Any] | None:
    """Return the program that tells two fitted hypotheses apart best, or None if their bodies do not run.

    Parameters
    ----------
    problem : whose robot and simulator the hypotheses are about
    first, second : fitted; the second may change its parameters to resemble the first under any program, to first order
    noise_m : rms of the noise of one sample of the motion, over its components

    Returns
    -------
    dict
        program in words, duration_s, and separation: the difference that is left in standard deviations of the noise
    """
    robot = problem.robot
    sensing = Sensing(STEP_S, problem.numerics.bin_s, max(noise_m, 1e-6), None)
    one, other = (_rival(problem, trial) for trial in (first, second))
    pair = Pair(one, other, one.point, other.point)
    try:
        chosen = plan([pair], blocks(robot, STEP_S, REST_S, 0), sensing, 60.0 * MINUTES, EFFORT)
        reached = sum(separation(sums(pair, block.pressure, sensing)) for block in chosen)
    except SolverError:
        return None
    counted = Counter(block.label for block in chosen)
    return {
        "program": "; ".join(f"{label} ({n} times)" if n > 1 else label for label, n in counted.items()),
        "duration_s": STEP_S * sum(len(block.pressure) for block in chosen),
        "separation": float(reached),
    }


def _rival(problem: Problem, trial: Trial) -> Rival:
    """Return the hypothesis as the planner takes it, at its fitted parameters."""
    space = problem.space(trial.hypothesis)
    tuned = space.tuned(trial.fit.point)
    body = problem.simulator.with_parameters(**tuned) if tuned else problem.simulator
    label = trial.hypothesis.label()
    return Rival(label, problem.robot, body, space.effects(trial.fit.point), problem.numerics.tuned_factor)
