"""Rows, windows and loads mean what they say."""

import numpy as np
import torch

from softrl.dynamics.dataset import Body, Windows, coordinates_of, random_loads, rolled, trajectories_from
from softrl.robots.robot import Robot

DT_S = 0.01
LOW, HIGH = np.array([-2e4] * 3 + [-1.0] * 3), np.array([3.5e4] * 3 + [1.0] * 3)


def test_loads_stay_in_range_start_at_zero_and_obey_the_slew(robot: Robot) -> None:
    load = random_loads(robot, LOW, HIGH, 8, 300, DT_S, np.random.default_rng(0))
    assert (load >= LOW - 1e-9).all()
    assert (load <= HIGH + 1e-9).all()
    assert not load[:, 0, :3].any()
    assert np.abs(np.diff(load[..., :3], axis=1)).max() <= robot.slew_pa_per_s * DT_S + 1e-6
    assert load[:, :, 3:].any(axis=(1, 2)).tolist() == [True, True, False, False] * 2


def test_states_are_the_sum_of_their_rates_and_hold_the_coordinates(body: Body, robot: Robot) -> None:
    load = random_loads(robot, LOW, HIGH, 3, 60, DT_S, np.random.default_rng(1))
    runs = rolled(body, load, robot.axis, DT_S)
    np.testing.assert_allclose(runs.state[:, :1] + DT_S * np.cumsum(runs.rate, axis=1), runs.state, atol=1e-12)
    z = coordinates_of(torch.tensor(runs.state), torch.tensor(body.rest_tip)).numpy()
    again = body.roll(load[:, 1:], z[:, 0], np.zeros((3, 6)), DT_S)
    np.testing.assert_allclose(z[:, 1:], again, atol=1e-12)


def test_window_ends_at_its_row_and_the_target_is_the_next_rate() -> None:
    steps = np.arange(10.0)
    z = np.zeros((2, 10, 6))
    z[..., 5] = 0.001 * steps + 0.1 * np.arange(2)[:, None]
    load = np.zeros((2, 10, 6))
    load[..., 0] = steps
    still = np.tile([1.0, 0.0, 0.0, 0.0], (2, 10, 1))
    runs = trajectories_from(z, still, load, np.array([0.0, 0.0, 0.17]), "+z", DT_S)
    windows = Windows(runs, 3)
    assert len(windows) == 18
    rows, rate = windows.take(torch.tensor([0, 5, 9 + 8]))
    np.testing.assert_allclose(rows[1, :, 22], [4.0, 5.0, 6.0])  # loads held from rows 3, 4, 5 on
    np.testing.assert_allclose(rows[1, :, 2], 0.17 + 0.001 * np.array([3.0, 4.0, 5.0]), rtol=1e-6)
    np.testing.assert_allclose(rate[:, 2], 0.1, rtol=1e-4)
    # before the start: at rest, without load
    np.testing.assert_allclose(rows[0, :, 22], [0.0, 0.0, 1.0])
    assert not rows[0, :, 11:22].any()
    inside = Windows(runs, 3, from_rest=False)
    assert len(inside) == 2 * 6
    np.testing.assert_allclose(inside.take(torch.tensor([0]))[0][0, :, 22], [2.0, 3.0, 4.0])
    _, ahead, rates = inside.take_segments(torch.tensor([0]), 4)
    np.testing.assert_allclose(ahead[0, :, 0], [4.0, 5.0, 6.0, 7.0])
    assert rates.shape == (1, 4, 11)


def test_a_tip_that_bends_past_half_a_turn_goes_on_turning() -> None:
    """Its rotation vector would else jump by a whole turn, 600 rad/s, which no network foretells and all scales drown in."""
    angle = np.linspace(0.0, 4.5, 60)
    quaternion = np.stack([np.cos(angle / 2), 0 * angle, np.sin(angle / 2), 0 * angle], axis=-1)[None]
    runs = trajectories_from(np.zeros((1, 60, 6)), quaternion, np.zeros((1, 60, 6)), np.array([0.0, 0.0, 0.17]), "+z", DT_S)
    np.testing.assert_allclose(runs.rate[0, 1:, 6], 4.5 / 59 / DT_S, rtol=1e-9)
