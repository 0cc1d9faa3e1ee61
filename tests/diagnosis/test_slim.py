"""What says the same with fewer parameters is told with fewer."""

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Choice, Gate, Hypothesis, effect_axes, starts
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.minimise import Fit
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.slim import _contained, slim
from softrl.effects.leak import Leak
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made


def test_a_gate_in_which_nothing_happens_goes_whatever_is_said_of_runs_left_out(body: PccSimulator) -> None:
    """Until the first command nothing leaks; estimates of runs left out may differ all the same."""
    config = configured()
    runs = made(body, (Leak(0.3, 2.0, 1.0),), sessions=2, noise_m=1e-5).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    gated = Choice("leak", pinned=("exponent", "over_s"), gate=Gate("since_s", 0.0))
    hypothesis, point = Hypothesis((gated,), ()), starts(gated)[0]
    for axis, column in zip(effect_axes(gated), range(len(point)), strict=True):
        point[column] = axis.scaled({"leak_per_s": 0.3, "refill_s": 2.0, "since_s": 0.0}[axis.name])
    residual = problem.residual(hypothesis, point)
    jacobian = np.zeros((len(residual.flat), len(point)))
    fit = Fit(point, residual.flat, jacobian, 0.5 * float(residual.flat @ residual.flat), 0)
    lucky = 1e-9 * residual.squares  # better than any refit without the gate could be said to be
    trial = Trial(hypothesis, fit, {}, lucky, lucky)
    judge = Judge(problem, 1e-6, 0.03, config.thresholds, 0)
    left = slim(problem, judge, trial, config.search, Path(trial, trial))
    assert left.hypothesis.effects == (Choice("leak", pinned=("exponent",)),)
    np.testing.assert_array_equal(left.squares, lucky)


def test_the_law_within_another_keeps_how_suddenly_its_gate_opens() -> None:
    """What is never bounded is a lag: its gate's width stays pinned, of which its point would know nothing."""
    gated = Choice("rate_limit", pinned=("over_s",), gate=Gate("since_s", 10.0))
    axes = effect_axes(gated)
    point = np.array([axis.scaled(0.0 if axis.name == "lag_s" else 10.0) for axis in axes])
    fit = Fit(point, np.zeros(1), np.zeros((1, len(point))), 0.0, 0)
    trial = Trial(Hypothesis((gated,), ()), fit, {}, np.zeros(1), np.zeros(1))
    ((hypothesis, begin, _),) = _contained(trial, gated)
    (less,) = hypothesis.effects
    assert less.name == "lag" and less.pinned == ("over_s",) and len(begin) == len(effect_axes(less))
    assert np.isfinite(begin).all()
