"""Retuned parameters at an end of their plausible range: a sign of what is missing only if data reject their nominal value."""

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, fit_trials, from_nominal
from softrl.diagnosis.judging.correct import Model


def rejected_nominal(training: Problem, judge: Judge, model: Model, search: Search) -> tuple[str, ...]:
    """Return the parameters of ``model`` at an end of their range of which held-out runs tell that they are not nominal.

    A light body hangs as it does with a quarter of its mass: what the data do not tell may end anywhere in its range.

    Parameters
    ----------
    training : the runs that fitted ``model``
    judge : of the held-out runs
    model : a competitor with retuned parameters
    search : of the fits in which one of them is nominal, and the others make up for it
    """
    ends = training.space(model.hypothesis).at_the_end(model.point)
    if not ends:
        return ()
    free = judge.problem.residual(model.hypothesis, model.point, model.placed).squares
    found = []
    for name in ends:
        held = _held_at_nominal(training, judge, model, name, search)
        if held is None or judge.tells(held, free):
            found.append(name)
    return tuple(found)


def _held_at_nominal(training: Problem, judge: Judge, model: Model, name: str, search: Search) -> np.ndarray | None:
    """Return squared errors (bins,) on held-out runs of ``model`` refitted with the nominal ``name``; None if none runs."""
    tuned, count = model.hypothesis.tuned, len(model.point)
    start = np.delete(model.point, count - len(tuned) + tuned.index(name))
    less = Hypothesis(model.hypothesis.effects, tuple(other for other in tuned if other != name))
    fitted = fit_trials(training, judge.problem, [(less, [start, *from_nominal(start, less)])], search)
    return fitted[0].squares if fitted else None
