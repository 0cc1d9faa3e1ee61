"""What a fit holds fixed and what may yet be otherwise: pinned parameters, and where along the robot its mass is."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import Hypothesis, effect_axes, pinned_values
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial, columns_of
from softrl.diagnosis.series.least_squares import UNSEEN
from softrl.pcc.simulator import PccSimulator

STEP = 0.02  # of differences, scaled units
PINNED = -1  # the column of a parameter that has none
UNEVEN_SHARE = 0.1  # of weight and inertia: what a robot whose mass is not evenly spread has otherwise, see ``weight_error``
NUDGE = 0.05  # share of the weight by which it is varied


class Freed(NamedTuple):
    """A trial with the parameters free that were pinned, at their neutral values still, and which (p,) of its are these."""

    trial: Trial
    pinned: np.ndarray


def freed(problem: Problem, trial: Trial) -> Freed:
    """Return ``trial`` with all its parameters free.

    Derivatives by those that were pinned are found here; they are zero where the body does not run beside neutral.
    """
    effects = tuple(choice._replace(pinned=choice.pinned_widths) for choice in trial.hypothesis.effects)
    whole = Hypothesis(effects, trial.hypothesis.tuned)
    point, source = [], []
    for choice, free in zip(trial.hypothesis.effects, effects, strict=True):
        mine = dict(zip((axis.name for axis in effect_axes(choice)), columns_of(trial, choice), strict=True))
        neutral = pinned_values(choice)
        for axis in effect_axes(free):
            source.append(int(mine.get(axis.name, PINNED)))
            point.append(axis.scaled(neutral[axis.name]) if axis.name in neutral else trial.fit.point[mine[axis.name]])
    tuned = np.arange(len(trial.fit.point) - len(whole.tuned), len(trial.fit.point))
    at, source_of = np.r_[point, trial.fit.point[tuned]], np.r_[source, tuned].astype(int)
    pinned = source_of == PINNED
    jacobian = np.where(pinned, 0.0, trial.fit.jacobian[:, np.maximum(source_of, 0)])
    axes = problem.space(whole).axes
    for k in np.flatnonzero(pinned):
        step = STEP if axes[k].physical(float(at[k])) < axes[k].high else -STEP
        try:
            moved = problem.residual(whole, at + step * (np.arange(len(at)) == k)).flat
        except SolverError:
            continue
        jacobian[:, k] = (moved - trial.fit.residual) / step
    return Freed(trial._replace(hypothesis=whole, fit=trial.fit._replace(point=at, jacobian=jacobian)), pinned)


def weight_error(problem: Problem, trial: Trial) -> np.ndarray:
    """Return how far the parameters (p,) may be off, in scaled units, because the lumped body's mass is spread evenly.

    Notes
    -----
    With a tenth of its mass in a plate at its end a robot has 1.1 times the moment of an evenly heavy one under its weight and
    1.31 times its inertia (a point mass at the tip of a rod counts as 1 / 0.243 of the rod's own). A retuned mass makes up for
    the mean; what is left is taken to be ``UNEVEN_SHARE`` of weight and of inertia, each by itself. Where a wall creeps, what
    hung on it before the first sample was borne by what had not relaxed by then, too; how much of that had is in no recording.
    A body that was made from a mesh has no such error.
    """
    if problem.target == "pressure" or not isinstance(problem.simulator, PccSimulator):
        return np.zeros(len(trial.fit.point))
    longest = max(float(run.time[-1] - run.time[0]) for run in problem.runs)
    effects = problem.space(trial.hypothesis).effects(trial.fit.point)
    unrelaxed = sum(effect.unrelaxed(longest) for effect in effects)
    errors = _moves(problem, trial, weight=1.0 + NUDGE), _moves(problem, trial, inertia=1.0 + NUDGE)
    return np.asarray((UNEVEN_SHARE + unrelaxed) / NUDGE * errors[0] + UNEVEN_SHARE / NUDGE * errors[1])


def _moves(problem: Problem, trial: Trial, weight: float = 1.0, inertia: float = 1.0) -> np.ndarray:
    """Return how far the parameters (p,) go to take up so many times the body's weight and inertia."""
    robot = problem.simulator.robot
    pull = tuple(weight / inertia * g for g in robot.gravity_m_s2)
    other = replace(robot, gravity_m_s2=pull, mass_kg=inertia * robot.mass_kg)
    changed = replace(problem, simulator=replace(problem.simulator, robot=other))
    try:
        moved = changed.residual(trial.hypothesis, trial.fit.point).flat - trial.fit.residual
    except SolverError:
        return np.zeros(len(trial.fit.point))
    return np.asarray(np.abs(taken_up(trial.fit.jacobian, moved[:, None])[:, 0]))


def taken_up(jacobian: np.ndarray, changes: np.ndarray) -> np.ndarray:
    """Return the moves (p, q) of least-squares parameters by which they take up ``changes`` (rows, q) of the residual."""
    size = np.linalg.norm(jacobian, axis=0)
    free = size > 0.0
    scaled = jacobian[:, free] / size[free]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=UNSEEN, hermitian=True)
    moves = np.zeros((jacobian.shape[1], changes.shape[1]))
    moves[free] = -inverse @ (scaled.T @ changes) / size[free][:, None]
    return moves
