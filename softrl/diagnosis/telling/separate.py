"""What to record next: pieces of a program under which hypotheses that fit alike part most, beside the noise."""

from typing import Any

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial
from softrl.excite.block import blocks
from softrl.excite.rival import Rival
from softrl.excite.separation import Sensing, normal, responses, tangent
from softrl.recordings.gone import Now

PIECES = 3
STEP_S = 0.02
REST_S = 2.0


def separation(first: Rival, second: Rival, pressure: np.ndarray, sensing: Sensing) -> float:
    """Return the difference of two responses, in standard deviations of the noise.

    Parameters
    ----------
    first, second : at their fitted parameters; the second may change them to resemble the first, to first order
    pressure : (steps, chambers) Pa, the program
    sensing : step and noise
    """
    truth = responses([first.at(first.point)], pressure, sensing)[0]
    return float(normal(truth, tangent(second, second.point, pressure, sensing)).distance())


def gap(first: Rival, second: Rival, pressure: np.ndarray, sensing: Sensing) -> float:
    """Return the same while no parameter changes, which is never less."""
    one, other = responses([first.at(first.point), second.at(second.point)], pressure, sensing)
    return float(np.linalg.norm(one - other))


def separating_program(
    problem: Problem, first: Trial, second: Trial, noise_m: float, now: Now
) -> dict[str, Any] | None:
    """Return the pieces that tell two fitted hypotheses apart best per second, or None if nothing that is recorded now does.

    Parameters
    ----------
    problem : whose robot and simulator the hypotheses are about
    first, second : fitted
    noise_m : rms of the noise of one sample of the motion, of all its components together
    now : where recording has come to: what acted in other sessions only does nothing, and what lasts goes on

    Returns
    -------
    dict
        program in words, duration_s, and separation: the difference that is left in standard deviations of the noise,
        of all pieces together

    Notes
    -----
    Every piece is judged from rest; ``stage=excite`` plans a whole program and refits the hypotheses to it.
    """
    components = 1 if problem.robot.output == "bend_angle" else 3
    sensing = Sensing(STEP_S, problem.numerics.bin_s, max(noise_m, 1e-6) / components**0.5, None)
    one, other = (_rival(problem, trial, now) for trial in (first, second))
    pieces = blocks(problem.robot, STEP_S, REST_S, 0)
    length = STEP_S * np.array([len(piece.pressure) for piece in pieces])
    worth = np.zeros(len(pieces))  # squared separation per second, of the pieces that may be among the best
    try:
        most = np.array([gap(one, other, piece.pressure, sensing) for piece in pieces]) ** 2 / length
        for k in np.argsort(-most):
            if most[k] > np.sort(worth)[-PIECES]:
                worth[k] = separation(one, other, pieces[k].pressure, sensing) ** 2 / length[k]
    except SolverError:
        return None
    best = [k for k in np.argsort(-worth)[:PIECES] if worth[k] > 0.0]
    if not best:
        return None
    return {
        "program": "; then ".join(pieces[k].label for k in best),
        "duration_s": float(length[best].sum()),
        "separation": float(np.sqrt(np.sum(worth[best] * length[best]))),
    }


def _rival(problem: Problem, trial: Trial, now: Now) -> Rival:
    """Return the hypothesis as the planner takes it, at its fitted parameters, from now on."""
    space = problem.space(trial.hypothesis)
    tuned = space.tuned(trial.fit.point)
    body = problem.simulator.with_parameters(**tuned) if tuned else problem.simulator
    label = trial.hypothesis.label()
    effects = space.effects(trial.fit.point, *now)
    return Rival(label, problem.robot, body, effects, problem.numerics.tuned_factor)
