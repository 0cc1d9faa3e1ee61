"""Whether numbers that a law has constant would have to change with the pressures: then it is another law.

A body that twists as it bends looks as if its sensor's frame were turned, by the mean of what it twists. The frame is turned
by as much in every pose; a turn that grows with the bending is none of the frame's.
"""

import numpy as np

from softrl.diagnosis.fitting.flexible import pressures
from softrl.diagnosis.fitting.hypothesis import effect_axes
from softrl.diagnosis.fitting.minimise import jacobian_at
from softrl.diagnosis.fitting.problem import Problem, Residual
from softrl.diagnosis.fitting.trial import Trial
from softrl.effects.library import effect_class

DIFFERENCE = 0.02  # scaled step of derivatives
SHRINK = 1e-6  # of the mean square of a column


def slopes(problem: Problem, trial: Trial, residual: Residual) -> list[np.ndarray]:
    """Return the derivatives (bins, channels, p) of the ``residual``, run by run, by the trial's parameters."""
    low, high = problem.space(trial.hypothesis).bounds

    def moved(point: np.ndarray) -> np.ndarray:
        return problem.residual(trial.hypothesis, point, trial.placed).flat

    columns = jacobian_at(moved, trial.fit.point, residual.flat, low, high, DIFFERENCE)
    ends = np.cumsum([run.size for run in residual.runs])[:-1]
    parts = zip(np.split(columns, ends), residual.runs, strict=True)
    return [part.reshape(*run.shape, -1) for part, run in parts]


def varied(training: Problem, trial: Trial, other: Problem) -> list[np.ndarray]:
    """Return (bins, channels) a run of ``other``: what is removed there where exact effects' numbers follow the pressures.

    To first order: every number of an effect whose law has no other form changes with how far the pressures bend the body and
    how far they lengthen it. Fitted on the runs of ``training``, beside small changes of all that is free.
    """
    residual = training.residual(trial.hypothesis, trial.fit.point, trial.placed)
    rows = [_columns(training, trial, residual, k, part) for k, part in enumerate(slopes(training, trial, residual))]
    matrix, left = np.concatenate(rows), residual.flat
    size = np.maximum(np.sqrt((matrix**2).mean(axis=0)), 1e-300)
    matrix = matrix / size
    normal = matrix.T @ matrix + SHRINK * len(matrix) * np.eye(len(size))
    weights = np.linalg.solve(normal, matrix.T @ left) / size
    there = other.residual(trial.hypothesis, trial.fit.point, trial.placed)
    found = []
    for k, part in enumerate(slopes(other, trial, there)):
        found.append((_columns(other, trial, there, k, part) @ weights).reshape(there.runs[k].shape))
    return found


def _columns(problem: Problem, trial: Trial, residual: Residual, number: int, part: np.ndarray) -> np.ndarray:
    """Return (rows, n): derivatives of a run's residual by all that is free, then by exact effects' numbers as they follow."""
    owners = [choice for choice in trial.hypothesis.effects for _ in effect_axes(choice)]
    exact = [k for k, choice in enumerate(owners) if effect_class(choice.name).exact]
    follow = _follow(problem, number)
    times = [part[:, :, exact] * column[:, None, None] for column in follow.T]
    return np.concatenate([part, *times], axis=2).reshape(residual.runs[number].size, -1)


def _follow(problem: Problem, number: int) -> np.ndarray:
    """Return (bins, 2) how far the pressures bend the body and how far they lengthen it, in shares of the largest pressure."""
    p = pressures(problem, number)
    if p.shape[1] == 1:
        return np.abs(p)
    around = np.asarray(problem.robot.chamber_direction)
    return np.stack([np.linalg.norm(p @ around, axis=1), p.mean(axis=1)], axis=1)
