"""The two public datasets, where they are at hand: they read, and the check says what is known about them."""

import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.recordings.check import check
from softrl.recordings.read import read
from softrl.robots.robot import Robot

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("SOFTRL_REAL_DATA", ROOT.parent / "shared" / "data"))
pytestmark = [
    pytest.mark.realdata,
    pytest.mark.skipif(not (DATA / "asu_smart_arm").is_dir(), reason=f"no real data at {DATA}"),
]


def robot_named(name: str) -> Robot:
    return Robot(**yaml.safe_load((ROOT / "conf" / "robot" / f"{name}.yaml").read_text()))


def test_arm_reads_in_one_frame() -> None:
    arm = robot_named("three_chamber_segment")
    recordings = read(DATA / "asu_smart_arm", arm)
    assert recordings.sessions() == ["2020_07-30", "2020_0908"]
    assert len(recordings.recordings) == 11
    for run in recordings.recordings:
        assert run.position is not None
        # with the session's axis turned to +z the tip stays above the base by most of the robot's length
        assert run.position[:, 2].min() > 0.7 * arm.length_m, run.name
    found = check(recordings, arm)
    assert found.excited == (0,)
    assert 3e-6 < found.noise_floor["position"] < 3e-4
    assert any("jumps" in w for w in found.warnings if w.startswith("2020_0908"))
    assert not any("jumps" in w for w in found.warnings if w.startswith("2020_07-30"))


def test_finger_reads_its_pump_command() -> None:
    finger = robot_named("single_chamber_finger")
    recordings = read(DATA / "pneunet_finger", finger)
    assert len(recordings.sessions()) == 3
    largest = max(np.abs(run.pressure_cmd).max() for run in recordings.recordings)
    assert largest == 255 * finger.command_to_pa
    assert all(run.bend_angle is not None and run.position is None for run in recordings.recordings)
