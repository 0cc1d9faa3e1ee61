"""Gauges that the motion contradicts are left out, and the report says so; a ceiling of the supply is no gauge that clips."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.judging.unbelieved import clipping, doubtful
from softrl.diagnosis.stage import run
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import RecordingSet
from tests.diagnosis.conftest import configured, made

Lag, SupplyLimit = effect_class("lag"), effect_class("supply_limit")
FEW = {"candidates": ["lag", "supply_limit", "stiffness_scale"], "search": {"max_effects": 2, "keep": 4}}
SHARE = 0.4  # of the robot's range
BEHIND = [(20.0, "unknown", True), (4.0, "unknown", False), (20.0, "named", False)]  # mm behind the gauges, verdict, doubted


def _clipped(recordings: RecordingSet, level: float) -> RecordingSet:
    runs = (replace(run, pressure_meas=np.minimum(run.pressure_meas, level)) for run in recordings.recordings)
    return replace(recordings, recordings=tuple(runs))


def test_a_gauge_that_clips_is_seen_where_commands_go_higher(body: PccSimulator) -> None:
    recordings, level = made(body, sessions=1, measured=True), SHARE * body.robot.pressure_max_pa
    cut = _clipped(recordings, level).recordings
    assert clipping(cut, body.robot) == {0: level, 1: level, 2: level} and not clipping(recordings.recordings, body.robot)
    assert not clipping(cut, replace(body.robot, command="pump_pwm"))
    gentle = [replace(run, pressure_cmd=np.minimum(run.pressure_cmd, level)) for run in cut]
    assert not clipping(gentle, body.robot)
    assert not clipping([replace(run, pressure_meas=None) for run in cut], body.robot)


@pytest.mark.parametrize(("behind_mm", "verdict", "doubted"), BEHIND)
def test_gauges_that_the_motion_follows_are_believed(behind_mm: float, verdict: str, doubted: bool) -> None:
    """Where commands tell little of a motion that follows its gauges, it is the valve that is not understood."""
    held = {"corrected": 50.0, "noise_floor": 0.2, "one_lag": 20.0, "static": 12.0, "blackbox": 0.3}
    left = {"measured pressure to motion": {"rms_above_noise_mm": behind_mm}}
    made: Any = SimpleNamespace(
        data={"measured_pressure_used": True}, errors_mm={"heldout": held}, errors_deg={}, unexplained=left, verdict=verdict
    )
    assert doubtful(made, {}) is doubted


@pytest.mark.slow
def test_gauges_that_clip_are_left_out(body: PccSimulator) -> None:
    """In the valve's part alone a ceiling of the supply looks the same; behind that the body would not bend as far."""
    cut = _clipped(made(body, (Lag(fill_s=0.15, vent_s=0.25),), seed=3, measured=True), SHARE * body.robot.pressure_max_pa)
    found = run(configured(**FEW), body.robot, cut, body, tracker=NullTracker())
    assert [e["name"] for e in found.effects] == ["lag"] and found.verdict == "named", found.sentences
    assert found.sentences[1].startswith("Measured pressures were left out") and not found.data["measured_pressure_used"]
    assert found.errors_mm["heldout"]["corrected"] < 1.2 * found.errors_mm["heldout"]["noise_floor"]


@pytest.mark.slow
def test_a_ceiling_of_the_supply_is_believed(body: PccSimulator) -> None:
    recordings = made(body, (SupplyLimit(ceiling=SHARE, floor=1.0),), seed=3, measured=True)
    coarse = _clipped(recordings, SHARE * body.robot.pressure_max_pa)  # a gauge of few values shows a ceiling so
    found = run(configured(**FEW), body.robot, coarse, body, tracker=NullTracker())
    assert found.data["measured_pressure_used"] and found.verdict in ("named", "indistinguishable"), found.sentences
    assert found.effects[0]["name"] in ("supply_limit", "knee")
