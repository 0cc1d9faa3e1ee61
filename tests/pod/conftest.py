"""Reduced models of synthetic bodies, fitted once."""

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.pod.fitting.basis import pod_basis
from softrl.pod.fitting.equilibria import equilibria
from softrl.pod.fitting.fit import fit_model
from softrl.pod.fitting.settings import FitSettings
from softrl.robots.robot import Robot
from tests.pod.synthetic import robot_with, synthetic_snapshots

SETTINGS = FitSettings(4, 3, 2, 18, 1, 1, (1e-15,), (0.0, 1.0), (0.01,), 0.3, 0.3, 0.1, 2)
_made: dict[int, tuple[Robot, Snapshots, ReducedModel]] = {}


def fitted(chambers: int) -> tuple[Robot, Snapshots, ReducedModel]:
    """Return robot, snapshots and reduced model of a synthetic body."""
    if chambers not in _made:
        robot = robot_with(chambers)
        snapshots = synthetic_snapshots(robot, 40, seed=chambers)
        pod = pod_basis(snapshots.displacement, snapshots.nodal_mass, 0.9999, 8)
        model, _ = fit_model(SETTINGS, robot, snapshots, equilibria(snapshots), pod, np.arange(40) % 2)
        _made[chambers] = robot, snapshots, model
    return _made[chambers]


@pytest.fixture(params=[1, 2, 3])
def body(request: pytest.FixtureRequest) -> tuple[Robot, Snapshots, ReducedModel]:
    """Return bodies of 1, 2 and 3 chambers in turn."""
    return fitted(request.param)


@pytest.fixture
def tripod() -> tuple[Robot, Snapshots, ReducedModel]:
    """Return the body of 3 chambers."""
    return fitted(3)
