"""What says the same with fewer parameters is told with fewer."""

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Gate, Hypothesis, effect_axes, starts
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.minimise import Fit, jacobian_at
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.slim import _contained, slim, without_silent
from softrl.effects.leak import Leak
from softrl.effects.viscoelasticity import Viscoelasticity
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


@pytest.mark.parametrize("pinned", [(), ("power",), ("residual",), ("residual", "power")])
def test_each_law_within_another_begins_where_that_is_and_keeps_what_is_pinned(pinned: tuple[str, ...]) -> None:
    """A wall that levels off at no residual, in the exponent of one that stiffens, has no logarithm."""
    locking = Choice("locking", pinned=pinned)
    told = {"softness": 2.0, "residual": 0.0, "growth": 0.5, "power": 3.0}
    point = np.array([axis.scaled(told[axis.name]) for axis in effect_axes(locking)])
    fit = Fit(point, np.zeros(1), np.zeros((1, len(point))), 0.0, 0)
    trial = Trial(Hypothesis((locking,), ()), fit, {}, np.zeros(1), np.zeros(1))
    found = _contained(trial, locking)
    assert [hypothesis.names for hypothesis, _, _ in found] == [("strain_softening",), ("strain_stiffening",)]
    for hypothesis, begin, _ in found:
        (less,) = hypothesis.effects
        assert not {axis.name for axis in effect_axes(less)} & {*pinned}
        for axis, u in zip(effect_axes(less), begin, strict=True):
            assert axis.physical(float(u)) == pytest.approx(told[axis.name])


def test_what_acts_in_the_second_of_two_branches_alone_is_told_as_the_first(body: PccSimulator) -> None:
    """Its numbers, and the derivatives by them, are those that a fit of the first alone has there."""
    config, creep = configured(), Choice("viscoelasticity")
    runs = made(body, (Viscoelasticity(0.0, 0.5, 0.4, 3.0),), sessions=2, noise_m=1e-5).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)

    def at(hypothesis: Hypothesis, point: np.ndarray) -> Trial:
        low, high = problem.space(hypothesis).bounds
        value = problem.residual(hypothesis, point)
        columns = jacobian_at(lambda u: problem.residual(hypothesis, u).flat, point, value.flat, low, high, 1e-4)
        fit = Fit(point, value.flat, columns, 0.5 * float(value.flat @ value.flat), 0)
        return Trial(hypothesis, fit, {}, value.squares, value.squares)

    told = {"share_1": 0.0, "relaxation_1_s": 0.5, "share_2": 0.4, "relaxation_2_s": 3.0}
    trial = at(Hypothesis((creep,), ()), np.array([axis.scaled(told[axis.name]) for axis in effect_axes(creep)]))
    judge = Judge(problem, 1e-6, 0.03, config.thresholds, 0)
    left = without_silent(problem, judge, trial, config.search, Path(trial, trial))
    (less,) = left.hypothesis.effects
    axes = effect_axes(less)
    values = {axis.name: axis.physical(u) for axis, u in zip(axes, left.fit.point, strict=True)}
    assert {"share_1", "relaxation_1_s"} <= values.keys() and "relaxation_2_s" in less.pinned
    assert [values["share_1"], values["relaxation_1_s"]] == pytest.approx([0.4, 3.0])
    fresh = at(left.hypothesis, left.fit.point).fit.jacobian
    kept = [k for k, axis in enumerate(axes) if axis.name.endswith(("_1", "_1_s"))]
    apart = np.linalg.norm(left.fit.jacobian[:, kept] - fresh[:, kept], axis=0)
    assert (apart < 1e-2 * np.linalg.norm(fresh[:, kept], axis=0)).all()  # of forward differences
