"""A robot's file: what is wrong in it is told in one line, with its key."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from softrl.core.config import build
from softrl.core.errors import ConfigError
from softrl.robots.robot import Robot

TRIPOD = yaml.safe_load((Path(__file__).resolve().parents[2] / "conf/robot/tripod.yaml").read_text())


@pytest.mark.parametrize(
    ("key", "value"),
    [("gravity_m_s2", [0.0, 0.0]), ("chamber_angle_deg", []), ("chamber_angle_deg", [0.0, math.nan]), ("command_to_pa", 0.0),
     ("tip_force_max_n", -1.0), ("slew_pa_per_s", math.nan), ("axis", "z"), ("output", "pose"), ("pressure_min_pa", 4e4)],
)  # fmt: skip
def test_a_wrong_robot_is_refused_with_its_key(key: str, value: Any) -> None:
    assert build(TRIPOD, Robot, "robot").chambers == 3
    with pytest.raises(ConfigError, match=f"^robot.{key}="):
        build(TRIPOD | {key: value}, Robot, "robot")
