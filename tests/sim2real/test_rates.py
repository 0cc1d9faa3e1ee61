"""Devices that sample seldom, or otherwise than they say: their watchdog is fed, and the slew is kept on their clock."""

import time
from dataclasses import replace

import numpy as np
import pytest

from softrl.core.errors import DriverError
from softrl.core.simulator import Simulator
from softrl.effects.chain import chain_of
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.protocol import PRESSURE_PA, Decoder, Flag, Kind, Welcome, values_of
from softrl.sim2real.drivers.regulator import Regulator
from softrl.sim2real.drivers.rig import Hardware, Noise
from tests.sim2real.line import LEVEL, Line, driver_on

RATE_HZ = 5.0


class SeldomLine(Line):
    """A line that is looked at often, to a device that samples seldom, in real time."""

    due = 0.0

    def receive(self) -> bytes:
        if time.monotonic() >= self.due:
            self.due = time.monotonic() + 1.0 / RATE_HZ
            return super().receive()
        time.sleep(0.001)
        data, self.answers = b"".join(self.answers), []
        return data


@pytest.fixture
def seldom(tripod: Robot, body: Simulator, silence: Noise) -> SeldomLine:
    """Return a line to a device of five samples a second."""
    return SeldomLine(Regulator(Hardware(body, chain_of(tripod, []), silence, RATE_HZ, RATE_HZ, 0.08), 0))


def test_the_watchdog_is_fed_between_samples_that_are_seldom(seldom: SeldomLine, tripod: Robot) -> None:
    setpoints = []

    def listen(pieces: list[bytes]) -> list[bytes]:
        setpoints.extend(piece for piece in pieces if Decoder().feed(piece)[0].kind == Kind.SETPOINT)
        return pieces

    with driver_on(seldom, tripod, link_timeout_s=5.0) as driver:
        driver.command(LEVEL)
        driver.advance(0.2)
        seldom.up = listen
        driver.advance(1.0)
    assert len(setpoints) > 2.0 * 1.0 / 0.08, "a watchdog of 80 ms hears of each second"


def test_a_device_slower_than_the_link_is_watched_is_refused(seldom: SeldomLine, tripod: Robot) -> None:
    with pytest.raises(DriverError, match=r"link_timeout_s=0.1 without one .*; expected more than 0.2 s") as error:
        with driver_on(seldom, tripod, link_timeout_s=0.1):
            pass
    assert "\n" not in str(error.value)


def test_the_slew_is_kept_on_the_clock_of_a_device_that_samples_more_often_than_it_says(line: Line, tripod: Robot) -> None:
    def understate(pieces: list[bytes]) -> list[bytes]:
        frames = [frame for piece in pieces for frame in Decoder().feed(piece)]
        said = Welcome(3, 10, 80, Flag(0)).encode()
        return [(replace(frame, payload=said) if frame.kind == Kind.WELCOME else frame).encode() for frame in frames]

    sent: list[tuple[float, np.ndarray]] = []

    def listen(pieces: list[bytes]) -> list[bytes]:
        for frame in (frame for piece in pieces for frame in Decoder().feed(piece)):
            if frame.kind == Kind.SETPOINT:
                sent.append((line.states[-1].clock_s, values_of(np.frombuffer(frame.payload, "<i4"), PRESSURE_PA)))
        return pieces

    line.down, line.up = understate, listen
    with driver_on(line, tripod) as driver:
        driver.command(LEVEL)
        driver.advance(0.5)
    clock_s, setpoint = (np.array(column) for column in zip(*sent, strict=True))
    np.testing.assert_array_equal(setpoint[-1], LEVEL)
    rate = np.abs(setpoint).max(axis=1) / (clock_s - clock_s[0] + 0.01)
    assert rate.max() <= tripod.slew_pa_per_s * (1 + 1e-6)
