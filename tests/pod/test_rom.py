"""Statics and inverse statics: force balance, weight, limits."""

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.pod.rom import pressure_for_tip, roll, static_coordinates, tip_poses
from softrl.pod.step import reach
from softrl.robots.robot import Robot
from tests.pod.synthetic import law_of

Body = tuple[Robot, Snapshots, ReducedModel]


def test_weight_is_in_balance(body: Body) -> None:
    robot, _, model = body
    law, loads = law_of(robot), np.zeros((2, model.order))
    loads[1, : model.chambers] = 1e4
    for z, load in zip(static_coordinates(model, loads), loads, strict=True):
        step = 1e-6
        slope = np.array(
            [
                (law.centre_of_mass(z + e) - law.centre_of_mass(z - e)) / (2 * step)
                for e in np.diag(np.r_[np.full(model.chambers, step), np.full(3, step)])
            ]
        )
        weight = model.mass * slope @ model.gravity_m_s2
        left = law.gradient(z) - load - weight
        assert np.abs(left[model.chambers :]).max() < 5e-3, left
        assert np.abs(left[: model.chambers]).max() < 1.0, left  # Pa of 10 kPa: what the ridges leave


def test_equilibria_and_poses_beyond_the_samples_are_reported(tripod: Body, caplog: pytest.LogCaptureFixture) -> None:
    robot, _, model = tripod
    loads = np.array([[0.5, 0.0, 0.0, 0.0, 0.0, 0.0], [8.0, 0.0, 0.0, 0.0, 0.0, 0.0]]) * robot.pressure_max_pa
    reach._reported.clear()
    z = static_coordinates(model, loads[:1])
    assert not caplog.records
    z = static_coordinates(model, loads)
    assert "times the reach of its snapshots" in caplog.text and "trust the equilibria less" in caplog.text
    tip_poses(model, 1.5 * z)
    assert "trust the tip's poses less" in caplog.text and len(caplog.records) == 2


def test_pressures_bring_the_tip_where_it_was(tripod: Body) -> None:
    robot, _, model = tripod
    rng = np.random.default_rng(0)
    loads = np.zeros((12, 6))
    loads[:, :3] = rng.uniform(0.9 * robot.pressure_min_pa, 0.9 * robot.pressure_max_pa, (12, 3))
    tip = static_coordinates(model, loads)[:, 3:] + model.rest_tip
    pressure, left = pressure_for_tip(model, tip)
    assert left.max() < 1e-8
    np.testing.assert_allclose(pressure, loads[:, :3], atol=1.0)


@pytest.mark.parametrize("far_m", [0.02, 0.06])
def test_a_tip_out_of_reach_is_approached_within_the_limits(body: Body, far_m: float) -> None:
    robot, _, model = body
    goal = model.rest_tip + far_m * np.array([[1.0, 0.5, 0.3], [0.0, 0.0, 1.0], [-0.2, -1.0, 0.0]])
    pressure, left = pressure_for_tip(model, goal)
    assert (pressure >= robot.pressure_min_pa).all() and (pressure <= robot.pressure_max_pa).all()
    n, rng = model.chambers, np.random.default_rng(0)
    for row, target, distance in zip(pressure, goal, left, strict=True):
        loads = np.zeros((20, n + 3))
        loads[:, :n] = np.clip(row + 1e3 * rng.standard_normal((20, n)), robot.pressure_min_pa, robot.pressure_max_pa)
        around = np.linalg.norm(static_coordinates(model, loads)[:, n:] + model.rest_tip - target, axis=1)
        assert distance <= around.min() + 1e-5


def test_a_batch_is_its_rows(tripod: Body) -> None:
    _, snapshots, model = tripod
    loads = snapshots.trajectory_load
    whole = roll(model, 0.01, loads)
    scale = np.diag(model.frame)
    np.testing.assert_allclose(whole[1:] / scale, roll(model, 0.01, loads[1:]) / scale, atol=1e-9)
    np.testing.assert_allclose(whole[:, :1] / scale, roll(model, 0.01, loads[:, :1]) / scale, atol=1e-9)
