"""A gauge whose zero is off is told, one that wanders with its range."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.lag import Lag
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

FEW = {"candidates": ["lag", "gain", "offset"], "search": {"max_effects": 1, "keep": 2}}


@pytest.mark.parametrize(("drift_pa", "told"), [(400.0, True), (0.0, False)])
def test_a_zero_that_wanders_is_told_with_its_range(body: PccSimulator, drift_pa: float, told: bool) -> None:
    whole = made(body, (Lag(fill_s=0.1, vent_s=0.1),), seed=3, sessions=5, measured=True)
    beside = [np.array([500.0, k * drift_pa, 0.0]) for k in range(len(whole.recordings))]
    runs = [replace(r, pressure_meas=r.pressure_meas + zero) for r, zero in zip(whole.recordings, beside, strict=True)]
    found = run(configured(**FEW), body.robot, replace(whole, recordings=tuple(runs)), body, tracker=NullTracker())
    lines = [line for line in found.sentences if "zero wanders" in line]
    assert bool(lines) == told, found.sentences
    off = [line for line in found.sentences if "as the gauge's zero" in line]
    assert len(off) == 1 and "chamber 1 reads 0.5 kPa more" in off[0], found.sentences
    if told:
        assert len(lines) == 1 and "chamber 2" in lines[0]
        low, high = (float(lines[0].split("reads ")[1].split(" kPa")[0].split(" to ")[k]) for k in (0, 1))
        assert high - low == pytest.approx(1e-3 * drift_pa * (len(runs) - 1), rel=0.1)
