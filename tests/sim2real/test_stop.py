"""Emergency stops and interrupts of a driver on a wire: nothing is commanded until a release, and no line stays open."""

import numpy as np
import pytest

from softrl.core.errors import DriverError
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.protocol import Decoder, Flag, Kind
from tests.sim2real.line import LEVEL, Line, driver_on, loses, silent


def test_an_emergency_stop_lasts_until_it_is_released(line: Line, tripod: Robot) -> None:
    driver = driver_on(line, tripod)
    with pytest.raises(DriverError, match="emergency stop"), driver:
        driver.command(LEVEL)
        driver.advance(0.2)
        driver.stop()
        driver.command(LEVEL)
    assert not line.states[-1].setpoint.any()
    with pytest.raises(DriverError, match="release"), driver:
        pass
    driver.release()
    with driver:
        driver.command(LEVEL)
        driver.advance(0.3)
        np.testing.assert_array_equal(driver.samples[-1].commanded, LEVEL)


def test_an_emergency_stop_lasts_though_the_device_never_hears_of_it(line: Line, tripod: Robot) -> None:
    driver = driver_on(line, tripod)
    with pytest.raises(DriverError, match="emergency stop"), driver:
        driver.command(LEVEL)
        driver.advance(0.2)
        line.up = loses(Kind.STOP)
        driver.stop()
        driver.command(LEVEL)
    line.up = list
    assert not line.states[-1].flags & Flag.STOPPED, "only the driver can remember"
    with pytest.raises(DriverError, match="release"), driver:
        pass
    driver.release()
    with driver:
        driver.command(LEVEL)
        assert driver.advance(0.3)[-1].commanded.any()


def test_a_stop_whose_first_frames_are_lost_is_said_again(line: Line, tripod: Robot) -> None:
    driver, lost = driver_on(line, tripod), []

    def lose_the_burst(pieces: list[bytes]) -> list[bytes]:
        stops = [piece for piece in pieces if Decoder().feed(piece)[0].kind == Kind.STOP]
        lost.extend(stops)
        return [] if stops and len(lost) <= 3 else pieces

    with pytest.raises(DriverError, match="emergency stop"), driver:
        driver.command(LEVEL)
        driver.advance(0.2)
        line.up = lose_the_burst
        driver.stop()
        driver.advance(0.2)
    assert line.states[-1].flags & Flag.STOPPED, "another driver is refused as well"


def test_a_stop_between_sessions_is_remembered(line: Line, tripod: Robot) -> None:
    driver = driver_on(line, tripod)
    driver.stop()
    with pytest.raises(DriverError, match="release"), driver:
        pass
    assert not line.states, "it is refused before the device is asked"
    line.down = silent
    driver._start_timeout_s = 0.1
    with pytest.raises(DriverError, match="no device answered"):
        driver.release()
    line.down, driver._start_timeout_s = list, 10.0
    with pytest.raises(DriverError, match="release"), driver:
        pass
    driver.release()
    with driver:
        assert driver.advance(0.1)


@pytest.mark.parametrize("way", ["entry", "release"])
def test_a_stop_in_the_middle_of_an_entry_or_a_release_counts(line: Line, tripod: Robot, way: str) -> None:
    driver = driver_on(line, tripod)

    def stop_at_the_answer(pieces: list[bytes]) -> list[bytes]:
        line.down = list
        driver.stop()
        return pieces

    line.down = stop_at_the_answer
    if way == "release":
        driver.release()
    with pytest.raises(DriverError, match="emergency stop"), driver:
        pass
    assert not any(state.setpoint.any() for state in line.states)


@pytest.mark.parametrize("way", ["_begin", "_vent"])
def test_an_interrupt_at_either_end_of_a_session_leaves_no_line_open(
    line: Line, tripod: Robot, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, closed = driver_on(line, tripod), []
    monkeypatch.setattr(line, "close", lambda: closed.append(line.device._setpoint.sent.any()))

    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(driver, way, interrupt)
    with pytest.raises(KeyboardInterrupt), driver:
        driver.command(LEVEL)
        driver.advance(0.2)
    assert closed == [False], "closed, and told to vent before"
    monkeypatch.undo()
    with driver:
        assert driver.advance(0.1)
