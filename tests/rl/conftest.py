"""A small surrogate of a body in closed form."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from softrl.artifacts.surrogate import Surrogate
from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.surrogate.stage import build_surrogate

CONF = Path(__file__).parents[2] / "conf"


def load(path: str) -> dict[str, Any]:
    """Return a file of conf/ as a plain mapping."""
    return yaml.safe_load((CONF / path).read_text())


def _surrogate_helpers() -> ModuleType:
    path = Path(__file__).parents[1] / "surrogate" / "conftest.py"
    spec = importlib.util.spec_from_file_location("surrogate_conftest", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def robot() -> Robot:
    """Return the default robot."""
    return build(load("robot/tripod.yaml"), Robot, "robot")


@pytest.fixture(scope="session")
def surrogate(robot: Robot) -> Surrogate:
    """Return a surrogate of a body of constant curvature."""
    made = _surrogate_helpers()
    return build_surrogate(made.tiny_config(), robot, None, made.lumped_body(robot), robot.length_m, NullTracker())


@pytest.fixture(scope="session")
def space(surrogate: Surrogate) -> Workspace:
    """Return its workspace."""
    return Workspace(surrogate)
