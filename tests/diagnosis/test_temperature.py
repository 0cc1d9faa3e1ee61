"""Where the temperature is recorded, a wall that follows it is told from one that drifts."""

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.data import Refusal, prepare
from softrl.diagnosis.stage import run
from softrl.effects.thermal_softening import ThermalSoftening
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

RIVALS = ["thermal_softening", "drift", "gain", "lag", "viscoelasticity"]


def warming(number: int, time: np.ndarray) -> np.ndarray:
    """Return a course (steps,), degree Celsius, that is no line in time and begins elsewhere every day."""
    return np.asarray(20.0 + 2.0 * number + 4.0 * np.sin(2.0 * np.pi * time / 17.0 + number))


def diagnosed(body: PccSimulator, softening_per_k: float) -> Diagnosis:
    recordings = made(body, (ThermalSoftening(softening_per_k=softening_per_k),), warmth=warming)
    return run(configured(candidates=RIVALS), body.robot, recordings, body, tracker=NullTracker())


def test_a_wall_that_softens_when_warm_is_named(body: PccSimulator) -> None:
    found = diagnosed(body, 0.02)
    assert [effect["name"] for effect in found.effects] == ["thermal_softening"], found.sentences
    entry = found.effects[0]["parameters"]["softening_per_k"]
    assert entry["value"] == pytest.approx(0.02, rel=0.03) and entry["low"] <= 0.02 <= entry["high"]
    by_pressure = [row for row in found.located if row["chamber"] is not None]
    assert "warmer" in max(by_pressure, key=lambda row: row["effect_size"])["region"]


def test_a_temperature_that_changes_nothing_is_not_named(body: PccSimulator) -> None:
    assert diagnosed(body, 0.0).verdict == "nothing missing"


@pytest.mark.parametrize(("swing", "varied"), [(0.3, ()), (4.0, ("temperature",))])
def test_only_a_temperature_that_changes_is_considered(body: PccSimulator, swing: float, varied: tuple[str, ...]) -> None:
    recordings = made(body, sessions=4, warmth=lambda _, time: 22.0 + swing * np.sin(time / 3.0))
    found = prepare(recordings, body.robot, 0.34, 0)
    assert not isinstance(found, Refusal) and found.varied == varied
