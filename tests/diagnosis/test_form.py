"""Intervals allow for what a fit held fixed: parameters at neutral values, and where the mass is."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.diagnosis.fitting.form import freed, taken_up, weight_error
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, effect_axes
from softrl.diagnosis.fitting.intervals import intervals, intervals_of_pinned
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial, fit_trials
from softrl.effects.contact import Contact
from softrl.effects.library import effect_class
from softrl.effects.power_creep import PowerCreep
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

TUNED = ("bending_stiffness_scale",)
NEUTRAL = {
    name: {f.name: float(f.metadata["neutral"]) for f in effect_class(name).parameter_fields()}
    for name in ("frame", "marker_offset", "payload")
}


def fitted(body: PccSimulator, choice: Choice, **hidden: float) -> tuple[Problem, Trial]:
    config = configured()
    runs = made(body, (effect_class(choice.name)(**(NEUTRAL[choice.name] | hidden)),), sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    return problem, fit_trials(problem, None, [(Hypothesis((choice,), TUNED), [])], config.search)[0]


def test_what_a_pinned_parameter_leaves_to_the_others_stands_in_their_intervals(body: PccSimulator) -> None:
    others = tuple(f.name for f in effect_class("frame").parameter_fields() if f.name not in ("turn_y_rad", "shift_x"))
    problem, both = fitted(body, Choice("frame", pinned=others), turn_y_rad=0.02, shift_x=0.004)
    _, alone = fitted(body, Choice("frame", pinned=(*others, "shift_x")), turn_y_rad=0.02, shift_x=0.004)
    thresholds = configured().thresholds
    free, held = intervals(problem, both, thresholds)[0], intervals(problem, alone, thresholds)[0]
    assert abs(held.value - 0.02) > 0.002 > abs(free.value - 0.02), "the turn takes over from the shift"
    assert free.low <= 0.02 <= free.high and held.low <= 0.02 <= held.high
    assert held.high - held.low < 0.2, "not everything is possible"


def test_derivatives_by_pinned_parameters_are_those_of_free_ones(body: PccSimulator) -> None:
    problem, both = fitted(body, Choice("marker_offset"), x=0.01, y=0.0, z=0.02)
    zero = both._replace(
        hypothesis=Hypothesis((Choice("marker_offset", pinned=("x", "z")),), TUNED),
        fit=both.fit._replace(point=both.fit.point[[1, 3]], jacobian=both.fit.jacobian[:, [1, 3]]),
    )
    start = problem.residual(zero.hypothesis, zero.fit.point).flat
    free, pinned = freed(problem, zero._replace(fit=zero.fit._replace(residual=start)))
    assert free.hypothesis == both.hypothesis and pinned[:4].tolist() == [True, False, True, False]
    assert free.fit.point[:3].tolist() == [0.0, zero.fit.point[0], 0.0]
    np.testing.assert_allclose(free.fit.jacobian, both.fit.jacobian, atol=0.02 * np.abs(both.fit.jacobian).max())


def test_a_parameter_that_is_held_has_an_interval_which_holds_what_is_hidden(body: PccSimulator) -> None:
    """A turn that noise nearly covers: it does not pay, and is not nought for it."""
    about_x = {"turn_x_rad": 0.02, "turn_y_rad": 0.001}
    others = tuple(f.name for f in effect_class("frame").parameter_fields() if f.name != "turn_x_rad")
    problem, trial = fitted(body, Choice("frame", pinned=others), **about_x)
    (held,) = intervals_of_pinned(problem, trial, configured().thresholds, freed(problem, trial)).values()
    assert [told.name for told in held] == list(others)
    by_name = {told.name: told for told in held}
    assert by_name["turn_y_rad"].low <= 0.0 <= 0.001 <= by_name["turn_y_rad"].high < 0.01
    assert all(told.low <= 0.0 <= told.high for told in held)


def test_nothing_held_has_no_interval(body: PccSimulator) -> None:
    problem, trial = fitted(body, Choice("payload"), mass=0.4)
    assert intervals_of_pinned(problem, trial, configured().thresholds, freed(problem, trial)) == {}


def test_a_weight_at_the_tip_is_as_certain_as_where_the_own_mass_is_and_a_valve_bears_none(body: PccSimulator) -> None:
    problem, trial = fitted(body, Choice("payload"), mass=0.4)
    mass = intervals(problem, trial, configured().thresholds)[0]
    assert mass.low < 0.38 < 0.42 < mass.high
    assert mass.value == pytest.approx(0.4, rel=0.02) and mass.high - mass.low < 0.3
    assert weight_error(problem, trial).all()
    assert not weight_error(replace(problem, target="pressure"), trial).any()


def test_a_creeping_wall_leaves_a_weight_less_certain(body: PccSimulator) -> None:
    config, creep = configured(), PowerCreep(share=0.6, exponent=0.12)
    runs = made(body, (effect_class("payload")(mass=0.4), creep), sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    trial = fit_trials(problem, None, [(Hypothesis((Choice("payload"), Choice("power_creep")), TUNED), [])], config.search)[0]
    wide = weight_error(problem, trial)[0]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(PowerCreep, "unrelaxed", lambda *_: 0.0)
        assert wide > 2.0 * weight_error(problem, trial)[0]


def test_moves_take_up_a_change_as_far_as_the_parameters_can() -> None:
    rng = np.random.default_rng(0)
    jacobian, wanted = rng.standard_normal((50, 3)) * [1.0, 1e3, 1e-3], np.array([[1.0], [-2e-3], [3e3]])
    np.testing.assert_allclose(taken_up(jacobian, -jacobian @ wanted), wanted, rtol=1e-9)
    jacobian[:, 1] = 0.0
    assert taken_up(jacobian, rng.standard_normal((50, 2)))[1].tolist() == [0.0, 0.0]


def test_a_direction_is_followed_past_half_a_turn_and_told_within_it(body: PccSimulator) -> None:
    config, choice = configured(), Choice("contact")
    wall = Contact(distance=0.05, azimuth_rad=-2.9, stiffness_n_per_m=100.0)
    problem = Problem(
        body.robot, body, made(body, (wall,), sessions=3).recordings, config.numerics, "motion", "command", False, False
    )
    axes = effect_axes(choice)
    told = {axis.name: getattr(wall, axis.name) for axis in axes} | {"azimuth_rad": 2.8}
    start = np.array([axis.scaled(told[axis.name]) for axis in axes])
    trial = fit_trials(problem, None, [(Hypothesis((choice,), ()), [start])], config.search)[0]
    turned = next(i for i in intervals(problem, trial, config.thresholds) if i.name == "azimuth_rad")
    assert turned.low <= -2.9 + 0.02 and turned.high >= -2.9 - 0.02 and -np.pi <= turned.value <= np.pi, turned
    assert abs(turned.value + 2.9) < 0.02 and not turned.at_bound
