"""The contract of every robot driver: pressures out, timed samples in, and safety in between."""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np


@dataclass(frozen=True)
class Sample:
    """One reading of the robot, stamped by the device's own clock; what was not measured is not a number.

    Attributes
    ----------
    time_s : s since the device started, increasing
    commanded : (chambers,) Pa, what the driver had sent last, after its limits
    pressure : (chambers,) Pa measured at the chambers
    position : (3,) m, tip in the base frame
    quaternion : (4,) w x y z
    tip_force : (3,) N, not a number where the robot has no force sensor
    """

    time_s: float
    commanded: np.ndarray
    pressure: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    tip_force: np.ndarray


class Stream(int):
    """A stage's own constant in the seed of what a simulated robot's noise is drawn from: no two stages meet the same."""


ANY_STREAM = Stream(0)  # outside of stages


class Driver(Protocol):
    """A robot that takes pressures. Used as a context manager: it vents on exit, on an exception, on a lost link.

    Attributes
    ----------
    samples : all that arrived since the last entry; they outlive a lost link
    stale_s : device time for which a reading of the tip may be acted on
    """

    samples: list[Sample]
    stale_s: float

    def __enter__(self) -> Self:
        """Connect; the robot is vented and its samples start."""
        ...

    def __exit__(self, *exception: object) -> None:
        """Vent and disconnect, whatever happened."""
        ...

    def command(self, pressure: np.ndarray) -> np.ndarray:
        """Send (chambers,) Pa and return what was sent, after the robot's limits of pressure and slew."""
        ...

    def advance(self, dt_s: float) -> list[Sample]:
        """Let ``dt_s`` pass on the device's clock and return the samples that arrived."""
        ...

    def stop(self) -> None:
        """Stop in an emergency, from any thread: vent, and refuse commands and entries until ``release``."""
        ...

    def release(self) -> None:
        """End an emergency stop; not while connected."""
        ...
