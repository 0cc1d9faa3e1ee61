"""Laws of what may be sent."""

import numpy as np
import pytest

from softrl.core.errors import DriverError
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.limits import Setpoint


def test_what_is_sent_ramps_to_the_clipped_request(tripod: Robot) -> None:
    setpoint = Setpoint(tripod, 0.01)
    first = setpoint.request(np.array([1e6, -1e6, 3e3]))
    rows = setpoint.advance(100)
    np.testing.assert_array_equal(rows[0], first)
    np.testing.assert_array_equal(rows[-1], [tripod.pressure_max_pa, tripod.pressure_min_pa, 3e3])
    assert np.abs(np.diff(rows, axis=0)).max() <= 0.01 * tripod.slew_pa_per_s * (1 + 1e-12)
    assert len(rows) == 18, "35 kPa at 2 kPa a period take 18 periods, and then nothing more is sent"


def test_asking_often_does_not_move_faster(tripod: Robot) -> None:
    setpoint = Setpoint(tripod, 0.01)
    for _ in range(50):
        setpoint.request(np.full(3, 30e3))
    np.testing.assert_array_equal(setpoint.advance(1), np.full((1, 3), 2e3))


def test_a_repeated_request_is_sent_again_so_that_the_robot_knows_it_is_meant(tripod: Robot) -> None:
    setpoint = Setpoint(tripod, 0.01)
    setpoint.request(np.full(3, 1e3))
    assert len(setpoint.advance(10)) == 1
    assert len(setpoint.advance(10)) == 0
    setpoint.request(np.full(3, 1e3))
    assert len(setpoint.advance(10)) == 1


def test_venting_is_immediate(tripod: Robot) -> None:
    setpoint = Setpoint(tripod, 0.01)
    setpoint.request(np.full(3, 30e3))
    setpoint.advance(100)
    setpoint.vent()
    assert not setpoint.sent.any()
    assert len(setpoint.advance(10)) == 0


@pytest.mark.parametrize("bad", [[1.0, np.inf, 0.0], [np.nan] * 3, [1.0, 2.0], 5.0])
def test_a_malformed_request_changes_nothing(tripod: Robot, bad: object) -> None:
    setpoint = Setpoint(tripod, 0.01)
    setpoint.request(np.full(3, 1e3))
    with pytest.raises(DriverError, match="expected"):
        setpoint.request(np.asarray(bad))
    np.testing.assert_array_equal(setpoint.advance(1), np.full((1, 3), 1e3))
