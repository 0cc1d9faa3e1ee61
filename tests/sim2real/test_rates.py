"""Devices that sample seldom, or otherwise than they say: their watchdog is fed, and the slew is kept on their clock."""

import time

import numpy as np
import pytest

from softrl.core.errors import DriverError
from softrl.core.simulator import Simulator
from softrl.effects.chain import chain_of
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.protocol import Decoder, Kind
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
    with pytest.raises(DriverError, match="link_timeout_s=0.1 without one .*; expected more than 0.2 s") as error:
        with driver_on(seldom, tripod, link_timeout_s=0.1):
            pass
    assert "\n" not in str(error.value)
