"""Trajectories in step: each moves as it does alone."""

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.pod.lanes import batch
from softrl.pod.lanes.products import TILE, multiply
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


def test_a_trajectory_is_bit_for_bit_the_same_in_any_block_and_company(
    tripod: Body, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, snapshots, model = tripod
    share = np.random.default_rng(1).uniform(-1.5, 1.5, (3 * TILE + 1, 1, 1))  # some inside the samples, some outside
    loads = share * snapshots.trajectory_load[0, :25]
    found = roll(model, 0.01, loads)
    monkeypatch.setattr(batch, "LANES", TILE)
    assert np.array_equal(roll(model, 0.01, loads), found)
    assert np.array_equal(roll(model, 0.01, loads[::-1].copy())[::-1], found)


@pytest.mark.parametrize("size", [(1, 1), (7, 5), (28, 21), (84, 144), (3, 462)])
def test_tiles_multiply_as_numpy_does_also_in_two_parts(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    table, values = rng.standard_normal(size), rng.standard_normal((size[0], 3 * TILE))
    rows = np.full((size[1], 3 * TILE), np.nan)
    multiply(table, values, 0, size[0], 3 * TILE, rows)
    assert np.allclose(rows, table.T @ values, rtol=0.0, atol=1e-12)
    half = size[0] // 2
    if half:
        rows[:] = np.nan
        multiply(table, values, 0, half, TILE + 1, rows)
        multiply(table, values, half, size[0], TILE + 1, rows)
        assert np.allclose(rows[:, : 2 * TILE], (table.T @ values)[:, : 2 * TILE], rtol=0.0, atol=1e-12)
        assert np.isnan(rows[:, 2 * TILE :]).all()
