"""A lumped body stands in for the reduced model: what the surrogate must reproduce is then known in closed form."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from softrl.artifacts.surrogate import Surrogate
from softrl.core.config import build, build_target
from softrl.core.tracking import NullTracker
from softrl.robots.robot import Robot
from softrl.surrogate.stage import Config, build_surrogate

CONF = Path(__file__).parents[2] / "conf"
QUASI_STATIC_S = 1e6


def load(path: str) -> dict[str, Any]:
    """Return a file of conf/ as a plain mapping."""
    return yaml.safe_load((CONF / path).read_text())


def tiny_config() -> Config:
    """Return the stage's config as ``profile=tiny`` composes it."""
    return build(load("stage/surrogate.yaml") | load("profile/tiny/surrogate.yaml") | {"seed": 0}, Config, "stage")


def lumped_body(robot: Robot) -> Callable[[np.ndarray], np.ndarray]:
    """Return loads (S, n + 3) Pa and N -> tips (S, 3) m of a constant-curvature body."""
    body = build_target(load("simulator/pcc.yaml"), "simulator", lambda hint: robot)
    rest = body.reset()

    def tip_of(loads: np.ndarray) -> np.ndarray:
        settled = (body.step(rest, row[:-3], QUASI_STATIC_S, row[-3:]) for row in loads)
        return np.stack([body.observe(state)[0] for state in settled])

    return tip_of


@pytest.fixture(scope="session")
def robot() -> Robot:
    """Return the default robot without weight."""
    return replace(build(load("robot/tripod.yaml"), Robot, "robot"), gravity_m_s2=(0.0, 0.0, 0.0))


@pytest.fixture(scope="session")
def tracker() -> NullTracker:
    """Return the tracker that the surrogate's stage reported to."""
    return NullTracker()


@pytest.fixture(scope="session")
def surrogate(robot: Robot, tracker: NullTracker) -> Surrogate:
    """Return a surrogate of the lumped body."""
    return build_surrogate(tiny_config(), robot, None, lumped_body(robot), robot.length_m, tracker)
