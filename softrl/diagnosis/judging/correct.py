"""Errors of the competitors from command to motion, at every sample that is compared, on training and held-out runs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.problem import Problem
from softrl.recordings.placement import Registration
from softrl.recordings.recording import Recording

SEEN = 2.0**0.5  # times the noise floor: a nominal error below has no gap to close


class Model(NamedTuple):
    """A competitor: what it contains, its scaled point, and the sessions' placements found on training runs.

    ``ends`` are its retuned parameters that the data drive to an end of their plausible range, see ``rejected_nominal``.
    """

    hypothesis: Hypothesis
    point: np.ndarray
    placed: dict[str, Registration]
    ends: tuple[str, ...] = ()


class Traces(NamedTuple):
    """One competitor on some runs: position (steps, 3) m, or bend angle (steps, 1) rad, a run."""

    predicted: list[np.ndarray]
    rms: float


def model_of(training: Problem, hypothesis: Hypothesis, point: np.ndarray) -> Model:
    """Return the competitor with placements fitted on the training runs."""
    return Model(hypothesis, point, training.residual(hypothesis, point).registrations)


def traces(problem: Problem, model: Model) -> Traces:
    """Return what a competitor predicts for the problem's runs, and its rms error in m (rad for an angle)."""
    replayed = problem.replayed(model.hypothesis, model.point)
    placed = problem.compare(replayed, model.placed).registrations
    predicted = [
        _placed(seen(problem, made), placed.get(run.session)) for run, made in zip(problem.runs, replayed, strict=True)
    ]
    return Traces(predicted, rms_error(problem, predicted))


def rms_error(problem: Problem, predicted: Sequence[np.ndarray]) -> float:
    """Return the rms, over all samples that are compared, of how far ``predicted`` (steps, n) by run is off, m (rad)."""
    return float(np.sqrt(np.nanmean(np.concatenate([off(problem, k, made) ** 2 for k, made in enumerate(predicted)]))))


def off(problem: Problem, number: int, predicted: np.ndarray) -> np.ndarray:
    """Return how far off (samples,) what is ``predicted`` (steps, n) of a run is, where it is compared; nan where it was lost."""
    run = problem.runs[number]
    apart = np.linalg.norm(seen(problem, run) - predicted, axis=1)
    return np.where(run.seen, apart, np.nan)[problem.first[number] :]


def seen(problem: Problem, run: Recording) -> np.ndarray:
    """Return the motion (steps, 3) m, or (steps, 1) rad for a robot that reports an angle."""
    if problem.robot.output == "bend_angle":
        return np.asarray(run.bend_angle)[:, None]
    return np.asarray(run.position)


def in_mm(errors: dict[str, float], length_m: float, angle: bool) -> dict[str, float]:
    """Return errors in mm; angles in rad become arc lengths."""
    return {name: 1e3 * (length_m if angle else 1.0) * error for name, error in errors.items()}


def _placed(points: np.ndarray, placement: Registration | None) -> np.ndarray:
    return points if placement is None else points @ placement.turn.T + placement.shift


def errors(found: dict[str, Traces], noise: float) -> dict[str, float]:
    """Return the rms error of every competitor, the noise floor first."""
    return {"noise_floor": noise} | {name: trace.rms for name, trace in found.items()}


def share_closed(heldout: dict[str, float]) -> float | None:
    """Return the share of the way from the nominal error to the noise floor that the correction goes; None without a way.

    Of rms errors, as blind trials have it: squares would call a third of the error left nine tenths removed.
    """
    nominal, corrected, floor = (heldout[name] for name in ("nominal", "corrected", "noise_floor"))
    return (nominal - corrected) / (nominal - floor) if nominal > SEEN * floor else None
