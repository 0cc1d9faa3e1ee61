"""A retuned parameter at an end of its range says that something is missing only if the data reject its nominal value."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging.correct import Model
from softrl.diagnosis.judging.ends import rejected_nominal
from softrl.diagnosis.telling.entries import retuned_entries
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

MASS, FACTOR = "mass_scale", 4.0


def ends(simulator: PccSimulator, true_mass: float, tuned: tuple[str, ...]) -> tuple[Problem, Model]:
    """Return the competitor with its mass at the upper end, after recordings of a body ``true_mass`` times as heavy."""
    config = configured()
    heavy = simulator.with_parameters(mass_scale=true_mass)
    runs = made(heavy, sessions=3).recordings
    problem = Problem(simulator.robot, simulator, runs, config.numerics, "motion", "command", False, False)
    judge = Judge(problem.on(runs[2:]), 1e-4, 0.03, config.thresholds, 0)
    hypothesis = Hypothesis((), tuned)
    point = np.array([np.log(FACTOR) if name == MASS else 0.0 for name in tuned])
    training = problem.on(runs[:2])
    model = Model(hypothesis, point, {})
    return training, model._replace(ends=rejected_nominal(training, judge, model, config.search))


def test_a_mass_that_no_run_shows_is_at_no_end_whatever_value_it_took(body: PccSimulator) -> None:
    light = replace(body, robot=replace(body.robot, mass_kg=0.1 * body.robot.mass_kg, gravity_m_s2=(0.0, 0.0, 0.0)))
    problem, model = ends(light, 1.0, (MASS,))
    assert problem.space(model.hypothesis).at_the_end(model.point) == [MASS] and model.ends == ()
    assert retuned_entries(problem, model)[MASS]["plausible"]


@pytest.mark.parametrize("tuned", [(MASS,), (MASS, "damping_s")])
def test_a_mass_that_the_runs_do_drive_to_its_end_is_told(body: PccSimulator, tuned: tuple[Any, ...]) -> None:
    problem, model = ends(body, FACTOR, tuned)
    assert model.ends == (MASS,)
    assert not retuned_entries(problem, model)[MASS]["plausible"]


def test_damping_has_a_longer_range_below(body: PccSimulator) -> None:
    """A wall that is stiff at first and gives way is damped by a time that its stiffness at rest makes short."""
    space = ends(body, 1.0, ("damping_s", MASS))[0].space(Hypothesis((), ("damping_s", MASS)))
    (least, lightest), (most, heaviest) = space.bounds
    np.testing.assert_allclose([least, lightest, most, heaviest], np.log(FACTOR) * np.array([-2.0, -1.0, 1.0, 1.0]))
    assert space.at_the_end(np.array([-np.log(FACTOR), -np.log(FACTOR)])) == [MASS]
    assert space.at_the_end(np.array([2.0 * -np.log(FACTOR), 0.0])) == ["damping_s"]
