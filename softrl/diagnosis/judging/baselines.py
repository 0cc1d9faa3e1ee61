"""Competitors of equal data that know no physics of the robot, and the simplest that knows some."""

from dataclasses import replace

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.flexible import BOXES, STATIC, best_map
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, fit_trials
from softrl.diagnosis.judging.correct import Model, Traces, model_of, rms_error, seen
from softrl.recordings.placement import Registration, place

SHORT_S = 0.02  # bins of a black box: in those of fits motion is blurred, which would count as its error


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
    """Return what a static map and a black box, the best of maps with memory and without, predict: split -> name -> traces.

    Parameters
    ----------
    training : runs that they are fitted to
    others : split -> runs that they are judged on
    placed : session -> placement; motions are compared in the base frame
    """
    found: dict[str, dict[str, Traces]] = {split: {} for split in others}
    for name, kinds, bin_s in (("static", [STATIC], training.numerics.bin_s), ("blackbox", BOXES, SHORT_S)):
        fitting = _in_bins(training, bin_s)
        predict = best_map(fitting, [_in_base(fitting, k, placed) for k in range(len(fitting.runs))], kinds)
        for split, problem in others.items():
            judged = _in_bins(problem, bin_s)
            found[split][name] = _traces(judged, predict(judged), placed)
    return found


def _in_bins(problem: Problem, bin_s: float) -> Problem:
    return replace(problem, numerics=replace(problem.numerics, bin_s=bin_s))


def _in_base(problem: Problem, number: int, placed: dict[str, Registration]) -> np.ndarray:
    """Return the measured motion (bins, channels) of a run in the simulator's base frame."""
    run = problem.runs[number]
    motion = seen(problem, run)
    if run.session in placed:
        turn, shift = placed[run.session]
        motion = (motion - shift) @ turn
    return problem.binned(number, motion)


def _traces(problem: Problem, rows_by_run: list[np.ndarray], placed: dict[str, Registration]) -> Traces:
    predicted = []
    for k, (run, rows) in enumerate(zip(problem.runs, rows_by_run, strict=True)):
        middle = problem.binned(k, run.time[:, None])[:, 0]
        motion = np.stack([np.interp(run.time, middle, column) for column in rows.T], axis=1)
        if placed:  # a session that no fit saw is placed by what is predicted, as for the models with physics
            turn, shift = placed.get(run.session) or place(motion[run.seen], seen(problem, run)[run.seen])
            motion = motion @ turn.T + shift
        predicted.append(motion)
    return Traces(predicted, rms_error(problem, predicted))
