"""What was left out is told from recordings of an arm and physics that share no code, and no form, with ours."""

from pathlib import Path

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.read import read
from softrl.robots.robot import Robot
from tests.diagnosis import foreign
from tests.diagnosis.conftest import configured, node

pytestmark = pytest.mark.slow
SEED = 3


def half_of_chamber_3_late(pressure: np.ndarray) -> np.ndarray:
    return np.where((foreign.TIME[:, None] > 20.0) & (np.arange(3) == 2), 0.5 * pressure, pressure)


CASES = {
    "lag": ({"lag"}, lambda p: foreign.first_order(p, 0.3), {"fill_s": 0.3, "vent_s": 0.3}),
    "late": ({"dead_time", "delay"}, lambda p: foreign.late(p, 0.25), {"delay_s": 0.265}),
    "rate": ({"rate_limit"}, lambda p: foreign.rate_limited(p, 120e3), {"rise_per_s": 0.48}),
    "throttle": ({"orifice"}, lambda p: foreign.throttled(p, 1.4), {"fill_s": 0.748}),
    "ceiling": ({"supply_limit", "knee"}, lambda p: np.minimum(p, 0.45 * foreign.FULL_PA), {}),
    "creep": ({"viscoelasticity"}, lambda p: 0.85 * p + 0.35 * foreign.first_order(p, 4.0), {}),
    "plays": ({"hysteresis", "play"}, lambda p: 0.4 * p + 0.6 * foreign.plays(p, (5e3, 15e3, 30e3)), {}),
    "failure": ({"failure", "gain"}, half_of_chamber_3_late, {"loss": 0.5, "onset_s": 20.0}),
}


def diagnosed(folder: Path) -> Diagnosis:
    robot = build(node("robot/three_chamber_segment.yaml"), Robot, "robot")
    body = PccSimulator(robot=robot, **node("simulator/pcc.yaml"))
    return run(configured(search={"workers": 1}), robot, read(folder, robot), body, tracker=NullTracker())


def test_another_arm_alone_has_nothing_missing(tmp_path: Path) -> None:
    found = diagnosed(foreign.write(tmp_path, SEED))
    assert found.verdict == "nothing missing", found.sentences


@pytest.mark.parametrize("name", CASES)
def test_what_acts_before_another_arm_is_named(tmp_path: Path, name: str) -> None:
    expected, act, values = CASES[name]
    found = diagnosed(foreign.write(tmp_path, SEED, act))
    (effect,) = found.effects
    assert effect["name"] in expected, found.sentences
    assert found.verdict in ("named", "indistinguishable")
    told = {key: entry["value"] for key, entry in effect["parameters"].items()}
    assert {key: told.get(key) for key in values} == pytest.approx(values, rel=0.06)
    held = found.errors_mm["heldout"]
    assert held["corrected"] < 0.5 * min(held["retuned"], held["static"]) and held["corrected"] < held["blackbox"]


def test_another_arm_seen_by_a_turned_camera(tmp_path: Path) -> None:
    turn = np.array([[np.cos(0.15), -np.sin(0.15), 0.0], [np.sin(0.15), np.cos(0.15), 0.0], [0.0, 0.0, 1.0]])
    found = diagnosed(foreign.write(tmp_path, SEED, see=lambda x: x @ turn.T))
    assert [effect["name"] for effect in found.effects] == ["frame"], found.sentences
    assert found.effects[0]["parameters"]["turn_z_rad"]["value"] == pytest.approx(0.15, abs=0.01)


def test_another_arm_that_is_softer_on_another_day(tmp_path: Path) -> None:
    found = diagnosed(foreign.write(tmp_path, SEED, day=1.2))
    assert [(effect["name"], effect["sessions"]) for effect in found.effects] == [("stiffness_scale", ["day0"])]
    assert found.effects[0]["parameters"]["scale"]["value"] == pytest.approx(1.2, rel=0.03)
