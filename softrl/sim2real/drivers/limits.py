"""What a driver may send, pressures within the robot's range, changing no faster than its slew; and to which device."""

import numpy as np

from softrl.core.errors import ConfigError, DriverError
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.protocol import WIDEST_PA, Flag, Welcome

WATCHDOG_MS = 100  # longest time without a setpoint in which a device may stay under pressure


class Setpoint:
    """The pressure last sent and the one it is on its way to; one step a period of the device.

    A vented robot whose range leaves out zero begins at the limit next to it, at once, as programs do
    (``recordings.program.limited``).

    Attributes
    ----------
    sent : (chambers,) Pa, zero at the start
    goal : (chambers,) Pa, the last request within the robot's range of pressure
    vented : nothing was requested since the start, or since the last venting; zero may be out of the range
    """

    def __init__(self, robot: Robot, period_s: float) -> None:
        self._robot = robot
        self._reach_pa = robot.slew_pa_per_s * period_s
        self.vent()

    def vent(self) -> None:
        """Forget the request: zero gauge in all chambers, at once, whatever the slew."""
        self.sent = self.goal = np.zeros(self._robot.chambers)
        self._unsent, self.vented = False, True

    def request(self, pressure: np.ndarray) -> np.ndarray:
        """Return what is sent first (chambers,) Pa on the way to ``pressure``.

        Raises
        ------
        DriverError
            If the request has another number of chambers or is not finite: that is a fault of the caller, and
            clipping would hide it.
        """
        pressure = np.asarray(pressure, dtype=float)
        chambers = self._robot.chambers
        if pressure.shape != (chambers,):
            raise DriverError(f"a command of shape {pressure.shape} for {self._robot.name}; expected ({chambers},) Pa")
        if not np.isfinite(pressure).all():
            raise DriverError(f"a command of {pressure} Pa for {self._robot.name}; expected finite numbers")
        self.goal = np.clip(pressure, self._robot.pressure_min_pa, self._robot.pressure_max_pa)
        self._unsent, self.vented = True, False
        return self._next()

    def advance(self, periods: int, share: float = 1.0) -> np.ndarray:
        """Return what is sent (sent, chambers) Pa, one row a period, until the goal is reached or time is up.

        Each row goes ``share`` of a period's way, below 1 where less time has passed.
        """
        rows: list[np.ndarray] = []
        while len(rows) < periods and (self._unsent or not np.array_equal(self.sent, self.goal)):
            self._unsent = False
            self.sent = self._next(share)
            rows.append(self.sent)
        return np.array(rows).reshape(len(rows), self._robot.chambers)

    def _next(self, share: float = 1.0) -> np.ndarray:
        begun, reach = np.clip(self.sent, self._robot.pressure_min_pa, self._robot.pressure_max_pa), share * self._reach_pa
        return begun + np.clip(self.goal - begun, -reach, reach)


def require_times(**times_s: float) -> None:
    """Refuse times of a driver that are not above zero; with one that is not a number nothing would ever be watched."""
    for name, value in times_s.items():
        if not value > 0.0:
            raise ConfigError(f"driver.{name}={value:g} must be positive")


def require_safe(device: Welcome, robot: Robot, link_timeout_s: float) -> None:
    """Refuse a device of another robot, one in emergency stop, one that would not vent by itself, and one too slow to watch.

    A robot of pressures that no frame holds is refused as well: they would be clipped without a word.

    Raises
    ------
    DriverError
        With what the device said, and what was expected of it.
    """
    if device.chambers != robot.chambers:
        raise DriverError(f"the device has {device.chambers} chambers, robot={robot.name} has {robot.chambers}")
    if robot.largest_pa > WIDEST_PA:
        raise DriverError(
            f"robot={robot.name} takes up to {robot.largest_pa:g} Pa; expected at most {WIDEST_PA:g} Pa, the widest that the "
            "protocol of a wire can tell: lower robot.pressure_max_pa, or write a driver of its own"
        )
    if device.flags & Flag.STOPPED:
        raise DriverError("the device is in emergency stop; end it at the device, or with driver.release()")
    if not 0 < device.watchdog_ms <= WATCHDOG_MS:
        raise DriverError(
            f"the device's own watchdog is {device.watchdog_ms} ms; expected above 0 and at most {WATCHDOG_MS} ms: set "
            "it in the device, which has to vent by itself when its driver falls silent"
        )
    if device.rate_hz <= 0:
        raise DriverError(
            f"the device sends {device.rate_hz} samples a second; expected 1 or more: set the rate of STATE in the device"
        )
    if link_timeout_s * device.rate_hz <= 1.0:
        raise DriverError(
            f"the device sends {device.rate_hz} samples a second, but after driver.link_timeout_s={link_timeout_s:g} without "
            f"one the link counts as lost; expected more than {1.0 / device.rate_hz:g} s: raise it, or the device's rate"
        )
