"""Pressure programs sent straight to the robot, so that a diagnosis can tell effects apart."""

from collections.abc import Iterator

import numpy as np

from softrl.core.driver import Driver
from softrl.recordings.program import record
from softrl.recordings.recording import Recording
from softrl.recordings.session import Identification, session_program
from softrl.robots.robot import Robot

__all__ = ["Identification", "record_sessions", "session_program"]


def record_sessions(
    driver: Driver, robot: Robot, settings: Identification, rng: np.random.Generator
) -> Iterator[Recording]:
    """Yield one recording a session; the driver is entered anew for each."""
    for number in range(settings.sessions):
        time, pressure = session_program(robot, settings, number, rng)
        name = f"identification_{number + 1}"
        with driver:
            recording = record(driver, robot, time, pressure, name, name)
        yield recording  # the robot is vented while the caller looks at it
