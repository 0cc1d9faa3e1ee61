"""Competitors of equal data that know no physics of the robot, and the simplest that knows some."""

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.flexible import (
    MEMORY_DEGREES,
    STATIC_DEGREES,
    Features,
    Ridge,
    fit_ridge,
    memory_features,
    static_features,
)
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, fit_trials
from softrl.diagnosis.judging.correct import Model, Traces, model_of, rms_error, seen
from softrl.recordings.placement import Registration, place


def one_lag(training: Problem, tuned_point: np.ndarray, search: Search) -> Model | None:
    """Return the body with retuned parameters behind one first-order lag, or None if it does not run."""
    choice = Choice("lag")
    hypothesis = Hypothesis((choice,), training.tuned)
    points = [np.r_[start, tuned_point] for start in starts(choice)[:1]]
    points.append(np.r_[starts(choice)[0], np.zeros_like(tuned_point)])
    fitted = fit_trials(training, None, [(hypothesis, points)], search)
    try:
        return model_of(training, hypothesis, fitted[0].fit.point) if fitted else None
    except SolverError:
        return None


def without_physics(
    training: Problem, others: dict[str, Problem], placed: dict[str, Registration]
) -> dict[str, dict[str, Traces]]:
    """Return what a static map and a map with memory predict: split -> name -> traces.

    Parameters
    ----------
    training : runs that they are fitted to
    others : split -> runs that they are judged on
    placed : session -> placement; motions are compared in the base frame
    """
    found: dict[str, dict[str, Traces]] = {split: {} for split in others}
    kinds = (("static", static_features, STATIC_DEGREES), ("blackbox", memory_features, MEMORY_DEGREES))
    for name, features, degrees in kinds:
        targets = [_in_base(training, k, placed) for k in range(len(training.runs))]
        ridge = fit_ridge(features(training), targets, training.folds, degrees)
        for split, problem in others.items():
            found[split][name] = _traces(problem, ridge, features(problem), placed)
    return found


def _in_base(problem: Problem, number: int, placed: dict[str, Registration]) -> np.ndarray:
    """Return the measured motion (bins, channels) of a run in the simulator's base frame."""
    run = problem.runs[number]
    motion = seen(problem, run)
    if run.session in placed:
        turn, shift = placed[run.session]
        motion = (motion - shift) @ turn
    return problem.binned(number, motion)


def _traces(problem: Problem, ridge: Ridge, features: Features, placed: dict[str, Registration]) -> Traces:
    predicted = []
    for k, run in enumerate(problem.runs):
        rows = ridge.predict(features.runs[k])
        middle = problem.binned(k, run.time[:, None])[:, 0]
        motion = np.stack([np.interp(run.time, middle, column) for column in rows.T], axis=1)
        if placed:  # a session that no fit saw is placed by what is predicted, as for the models with physics
            turn, shift = placed.get(run.session) or place(motion[run.seen], seen(problem, run)[run.seen])
            motion = motion @ turn.T + shift
        predicted.append(motion)
    return Traces(predicted, rms_error(problem, predicted))
