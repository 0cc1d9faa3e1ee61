"""A lumped body stands in for the reduced model: what the surrogate must reproduce is then known in closed form."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from softrl.artifacts.surrogate import Surrogate
from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.robots.robot import Robot
from softrl.surrogate.stage import Config, build_surrogate
from softrl.surrogate.stiffness import Poses

CONF = Path(__file__).parents[2] / "conf"
FULL_BEND_RAD, FULL_STRETCH = 0.6, 0.1
SOFTNESS_M_PER_N = np.array([2.5e-3, 2.5e-3, 2e-4])


def load(path: str) -> dict[str, Any]:
    """Return a file of conf/ as a plain mapping."""
    return yaml.safe_load((CONF / path).read_text())


def tiny_config() -> Config:
    """Return the stage's config as ``profile=tiny`` composes it."""
    return build(load("stage/surrogate.yaml") | load("profile/tiny/surrogate.yaml") | {"seed": 0}, Config, "stage")


def lumped_body(robot: Robot) -> Callable[[np.ndarray], Poses]:
    """Return loads (S, n + 3) Pa and N -> poses of a body of constant curvature that yields evenly to forces."""

    def pose_of(loads: np.ndarray) -> Poses:
        share = loads[:, :-3] / robot.pressure_max_pa
        bend = -FULL_BEND_RAD * share @ robot.chamber_direction
        angle = np.linalg.norm(bend, axis=1) + 1e-9
        length = robot.length_m * (1.0 + FULL_STRETCH * share.mean(axis=1))
        across = (length * (1.0 - np.cos(angle)) / angle**2)[:, None] * bend
        tip = np.column_stack([across, length * np.sin(angle) / angle]) + loads[:, -3:] * SOFTNESS_M_PER_N
        return Poses(tip, None)

    return pose_of


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
    return build_surrogate(
        tiny_config(), robot, None, lumped_body(robot), robot.length_m, tracker, rayleigh=(0.0, 0.02)
    )
