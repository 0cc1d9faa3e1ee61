"""What is done about the flaws of real recordings: pauses, wrong samples, and what a tensile curve shows."""

import os
from pathlib import Path

import numpy as np
import pytest

from softrl.calibration.material_fit import fit_materials, in_words
from softrl.calibration.tensile import read_tensile
from softrl.core.config import build
from softrl.diagnosis.checks.data import Data, prepare
from softrl.diagnosis.checks.prelude import preludes
from softrl.recordings.read import read
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import node

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("SOFTRL_REAL_DATA", ROOT.parent / "shared" / "data"))
pytestmark = [
    pytest.mark.realdata,
    pytest.mark.skipif(not (DATA / "asu_smart_arm").is_dir(), reason=f"no real data at {DATA}"),
]


def prepared(folder: str, robot_name: str) -> tuple[Data, Robot]:
    robot = build(node(f"robot/{robot_name}.yaml"), Robot, "robot")
    found = prepare(read(DATA / folder, robot), robot, 0.34, 0)
    assert isinstance(found, Data)
    return found, robot


def test_finger_sampled_in_bursts_is_bridged_not_refused() -> None:
    data, _ = prepared("pneunet_finger", "single_chamber_finger")
    runs = (*data.training, *data.heldout)
    assert sum(np.ptp(run.time) for run in runs) > 0.98 * sum(run.duration_s for run in data.check.runs)
    assert sum("samples are missing" in line for line in data.mended) >= 3
    assert max(np.abs(np.diff(run.bend_angle)).max() for run in runs) < 1.0  # the failed detections are gone


def test_arm_that_begins_while_it_fills_starts_at_rest() -> None:
    data, robot = prepared("asu_smart_arm", "three_chamber_segment")
    before = preludes(data.training, (*data.training, *data.heldout), robot)
    filling = [run for run in data.heldout if run.session == "2020_0908"]
    assert filling and all(run.pressure_meas[0, 0] > 40e3 for run in filling)
    assert all(before[run.name][0] < 20e3 for run in filling)


def test_every_real_elastomer_is_said_to_stiffen() -> None:
    for path in sorted((DATA / "material").glob("*.csv")):
        curve = read_tensile(path, 300, 3.0)
        assert "misses the strain stiffening" in in_words(curve, fit_materials(curve, 8)), path.name
