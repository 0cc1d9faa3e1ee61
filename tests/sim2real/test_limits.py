"""Laws of what may be sent."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.errors import DriverError
from softrl.core.simulator import Simulator
from softrl.effects.chain import chain_of
from softrl.recordings.program import limited
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.limits import Setpoint
from softrl.sim2real.drivers.protocol import PRESSURE_PA, Decoder, Flag, Frame, Kind, State, counts
from softrl.sim2real.drivers.regulator import Regulator
from softrl.sim2real.drivers.rig import Hardware, Noise
from tests.sim2real.line import Line, driver_on


def test_what_is_sent_ramps_to_the_clipped_request(tripod: Robot) -> None:
    setpoint = Setpoint(tripod, 0.01)
    first = setpoint.request(np.array([1e6, -1e6, 3e3]))
    rows = setpoint.advance(100)
    np.testing.assert_array_equal(rows[0], first)
    np.testing.assert_array_equal(rows[-1], [tripod.pressure_max_pa, tripod.pressure_min_pa, 3e3])
    assert np.abs(np.diff(rows, axis=0)).max() <= 0.01 * tripod.slew_pa_per_s * (1 + 1e-12)
    assert len(rows) == 18, "35 kPa at 2 kPa a period take 18 periods, and then nothing more is sent"


@pytest.mark.parametrize(("low", "high"), [(5e3, 35e3), (-35e3, -5e3)])
def test_nothing_outside_of_the_range_is_sent_to_a_robot_that_is_never_without_pressure(
    tripod: Robot, body: Simulator, silence: Noise, low: float, high: float
) -> None:
    robot, period_s = replace(tripod, pressure_min_pa=low, pressure_max_pa=high), 0.01
    asked = np.full((20, robot.chambers), 0.6 * (low + high))
    setpoint, device = Setpoint(robot, period_s), Regulator(
        Hardware(body, chain_of(robot, []), silence, 100.0, 100.0, 0.08), 0
    )
    setpoint.request(asked[0])
    rows = setpoint.advance(20)
    np.testing.assert_array_equal(rows, limited(robot, asked, period_s)[: len(rows)], "as programs do")
    assert low <= rows.min() and rows.max() <= high
    device.take(Frame(Kind.HELLO, 1, 1, bytes([robot.chambers])))
    for number, row in enumerate(rows):
        device.take(Frame(Kind.SETPOINT, 1, number + 2, counts(row, PRESSURE_PA)))
        device.tick()
    (state,) = Decoder().feed(device.tick() or b"")
    assert State.decode(state.payload, robot.chambers).flags == Flag(0)


@pytest.mark.parametrize(("low", "high"), [(5e3, 35e3), (-20e3, -5e3)])
def test_a_robot_that_is_never_without_pressure_is_driven_over_a_wire(
    tripod: Robot, body: Simulator, silence: Noise, low: float, high: float
) -> None:
    robot = replace(tripod, pressure_min_pa=low, pressure_max_pa=high)
    line = Line(Regulator(Hardware(body, chain_of(robot, []), silence, 100.0, 100.0, 0.08), 0))
    with driver_on(line, robot) as driver:
        assert not driver.advance(0.2)[-1].commanded.any(), "vented until it is told"
        driver.command(np.full(robot.chambers, 0.5 * (low + high)))
        np.testing.assert_array_equal(driver.advance(0.3)[-1].commanded, np.full(robot.chambers, 0.5 * (low + high)))
    assert not line.states[-1].setpoint.any() and not line.states[-1].flags


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
