"""Robot, lumped body and rigs that the tests of this room share."""

from pathlib import Path

import pytest
import yaml

from softrl.core.config import build, build_target
from softrl.core.simulator import Simulator
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.rig import Noise

CONF = Path(__file__).parents[2] / "conf"


@pytest.fixture(scope="session")
def tripod() -> Robot:
    """Return the default robot."""
    return build(yaml.safe_load((CONF / "robot" / "tripod.yaml").read_text()), Robot, "robot")


@pytest.fixture(scope="session")
def body(tripod: Robot) -> Simulator:
    """Return the lumped body of the default robot."""
    node = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text())
    return build_target(node, "simulator", lambda hint: tripod if hint is Robot else None)


@pytest.fixture(scope="session")
def silence() -> Noise:
    """Return sensors that report the truth."""
    return Noise(
        position_white_mm=0.0, position_coloured_mm=0.0, colour_s=1.0, orientation_white_deg=0.0,
        pressure_white_kpa=0.0, dropped_share=0.0,
    )  # fmt: skip
