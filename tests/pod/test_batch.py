"""Trajectories in step: each moves as it does alone."""

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.pod.rom import roll, roll_poses
from softrl.robots.robot import Robot

Body = tuple[Robot, Snapshots, ReducedModel]


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_a_batch_moves_as_one_by_one_inside_and_outside_the_samples(body: Body, factor: float) -> None:
    _, snapshots, model = body
    share = np.random.default_rng(0).uniform(-factor, factor, (40, 1, 1))
    loads = share * snapshots.trajectory_load[0, :25]
    start, rate = 0.1 * share[:, 0] * np.diag(model.frame), share[:, 0] * np.diag(model.frame)
    alone = roll_poses(model, 0.01, loads, start, rate).coordinate
    error = np.abs(roll(model, 0.01, loads, start, rate) - alone) / np.diag(model.frame)
    assert error.max() < 1e-9, error.max()
