"""A body whose stiffness changes along it, where the simulator's is even: no physics is named for it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging.another_body import _may_be_pressed
from softrl.diagnosis.stage import run
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.payload import Payload
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

FEW = {"candidates": ["lag", "frame", "marker_offset", "offset", "payload", "strain_stiffening"], "search": {"keep": 3}}


@pytest.fixture
def soft(body: PccSimulator) -> PccSimulator:
    """Return an even body that weight bends: its taper is plain to see."""
    return replace(body, robot=replace(body.robot, gravity_m_s2=(9.81, 0.0, 0.0)), bend_at_full_pressure_rad=1.2)


def diagnosed(soft: PccSimulator, ratio: float, *hidden: Effect, mass: float = 1.0) -> Diagnosis:
    recordings = made(replace(soft, stiffness_base_to_tip=ratio, mass_scale=mass), hidden, sessions=4)
    return run(configured(**FEW), soft.robot, recordings, soft, tracker=NullTracker())


def of_noise(found: Diagnosis) -> float:
    return float(found.errors_mm["heldout"]["corrected"] / found.errors_mm["heldout"]["noise_floor"])


@pytest.mark.parametrize("ratio", [1.6, 0.7])
def test_a_taper_is_no_missing_physics(soft: PccSimulator, ratio: float) -> None:
    found = diagnosed(soft, ratio)
    assert found.verdict == "nothing missing" and of_noise(found) < 1.1, found.sentences
    assert found.simulator_parameters["stiffness_base_to_tip"] == pytest.approx(ratio, rel=0.02)
    assert "let change along it" in found.sentences[1]


def test_behind_a_taper_a_lag_is_told_with_the_mass_that_the_body_has(soft: PccSimulator) -> None:
    found = diagnosed(soft, 1.6, Lag(fill_s=0.2, vent_s=0.3))
    assert [effect["name"] for effect in found.effects] == ["lag"] and of_noise(found) < 1.1, found.sentences
    assert found.simulator_parameters["stiffness_base_to_tip"] == pytest.approx(1.6, rel=0.02)
    assert found.simulator_parameters["mass_scale"] == pytest.approx(1.0, abs=0.02)
    told = found.effects[0]["parameters"]
    assert told["fill_s"]["value"] == pytest.approx(0.2, abs=0.005) and told["vent_s"]["value"] == pytest.approx(0.3, abs=0.005)


def test_an_even_body_keeps_its_form(soft: PccSimulator) -> None:
    found = diagnosed(soft, 1.0, Lag(fill_s=0.2, vent_s=0.3))
    assert "stiffness_base_to_tip" not in found.simulator_parameters
    assert [effect["name"] for effect in found.effects] == ["lag"] and of_noise(found) < 1.1, found.sentences


@pytest.mark.parametrize(
    ("mass", "named", "unknown", "pressed"),
    [
        (1.1, "lag", False, False),
        (3.0, "lag", False, True),
        (0.5, "lag", False, True),
        (1.0, "lag", True, True),
        (1.0, "payload", False, True),
    ],
)
def test_what_may_have_pressed_a_body_that_was_taken_for_shorter(
    body: PccSimulator, mass: float, named: str, unknown: bool, pressed: bool
) -> None:
    """A load beside larger slips was retuned away, by 3.8 times the mass, and taken for a length."""
    config, runs = configured(), made(body, sessions=2).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    hypothesis = Hypothesis((Choice(named),), ("mass_scale",))
    own = {"lag": (0.1, 0.1), "payload": (1.0,)}[named]
    scaled = [axis.scaled(value) for axis, value in zip(problem.space(hypothesis).axes, (*own, mass), strict=False)]
    trial = SimpleNamespace(hypothesis=hypothesis, fit=SimpleNamespace(point=np.array(scaled)))
    names = [SimpleNamespace(choice=hypothesis.effects[0])]
    finding: Any = SimpleNamespace(unknown=unknown, named=names, part=SimpleNamespace(problem=problem), final=trial)
    assert _may_be_pressed(finding, -0.01 * body.length_m) == pressed


@pytest.fixture
def light(body: PccSimulator) -> PccSimulator:
    """Return a small body whose mass, retuned, takes a load so well that what is left counts for nothing."""
    robot = replace(body.robot, chamber_radius_m=0.01, length_m=0.12, mass_kg=0.08)
    return replace(body, robot=robot, bend_at_full_pressure_rad=1.2)


def test_a_load_in_every_run_is_not_retuned_away(light: PccSimulator) -> None:
    """Of what does nearly as well, the mass that a scale would show."""
    found = diagnosed(light, 1.0, Lag(fill_s=0.1, vent_s=0.2), Payload(0.5))
    told = {effect["name"]: effect["parameters"] for effect in found.effects}
    assert set(told) == {"lag", "payload"} and of_noise(found) < 1.1, found.sentences
    assert told["payload"]["mass"]["low"] <= 0.5 <= told["payload"]["mass"]["high"]
    assert found.simulator_parameters["mass_scale"] == pytest.approx(1.0, abs=0.25)
    assert any("at most, or as much less" in line for line in found.sentences)


def test_a_mass_that_the_file_says_wrongly_is_no_load(light: PccSimulator) -> None:
    found = diagnosed(light, 1.0, Lag(fill_s=0.1, vent_s=0.2), mass=1.7)
    assert [effect["name"] for effect in found.effects] == ["lag"], found.sentences
