"""Following targets on a robot: observe, decide, smooth, send, at the pace of the robot's commands (Fig. 6b)."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from types import MappingProxyType
from typing import Protocol, runtime_checkable

import numpy as np

from softrl.core.driver import Driver, Sample
from softrl.core.errors import DriverError
from softrl.recordings.program import recording_of
from softrl.recordings.recording import Recording
from softrl.rl.filter import MovingAverage
from softrl.robots.robot import Robot
from softrl.sim2real.course import Course

FROZEN_S, MOVED_SHARE = 1.0, 0.05  # no tip stands still to the last digit for so long while this share of the range is sent


class Controller(Protocol):
    """Decides on pressures for a sequence of targets that it was made with."""

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return (chambers,) Pa for the target of ``step``, negative while the first target is approached.

        The tip is at ``position`` (3,) m and feels ``tip_force`` (3,) N.
        """
        ...


@runtime_checkable
class Watchful(Protocol):
    """A controller that looks at more than the tip."""

    def watch(self, arrived: Sequence[Sample], step: int) -> None:
        """Take in all samples (at least one) of the period before the command of ``step``."""
        ...


@dataclass(frozen=True)
class Pace:
    """How a rollout runs.

    Attributes
    ----------
    period_s : device time between commands
    average_window : commands in the moving average
    approach_steps : commands spent at the first target before the rollout counts
    """

    period_s: float
    average_window: int
    approach_steps: int


@dataclass(frozen=True)
class Rollout:
    """One course, followed.

    Attributes
    ----------
    recording : all samples, approach included
    course : what was to be followed
    reached : (steps, 3) m, last reading of the tip before the next command
    pressed : (steps,) N, force across the surface at the same times
    decision_s : (steps,) s of real time from reading to pressure
    """

    recording: Recording
    course: Course
    reached: np.ndarray
    pressed: np.ndarray
    decision_s: np.ndarray

    def error_m(self, wanted: np.ndarray | None = None) -> float:
        """Return the root mean square distance, m, between the tip and its targets, or ``wanted`` (steps, 3) m."""
        return float(np.sqrt(np.mean(self.course.position_error(self.reached, wanted) ** 2)))

    def force_error_n(self) -> float:
        """Return the mean absolute force error, N."""
        return float(np.mean(np.abs(self.pressed - self.course.force)))


def follow(
    driver: Driver, robot: Robot, controller: Controller, course: Course, pace: Pace, name: str, session: str,
    events: Mapping[int, Callable[[], None]] = MappingProxyType({}),
) -> Rollout:
    """Return how the robot behind ``driver``, which is connected here, follows ``course``.

    The decisions are timed; the robot's clock stands still meanwhile if it is a simulated one, and runs on if not.
    ``events`` happen before the command of their step. A decision rests on the last reading that has a position, and on a
    surface a force; a DriverError ends the rollout where there was none for the driver's ``stale_s``, or where it stands still
    while commands move.
    """
    average = MovingAverage(pace.average_window)
    last: list[Sample] = []
    decision_s = []
    with driver:
        arrived = _wait(driver, pace.period_s)
        if course.frame is not None and not any(np.isfinite(sample.tip_force).all() for sample in arrived):
            raise DriverError(
                f"course {course.name} presses on a surface, but the driver reports no force; connect a force sensor, "
                "or take a policy of task=track with inputs.policy=run:<id>"
            )
        samples = [*arrived]
        while (seen := _seen(samples, course, driver.stale_s)) is None:
            arrived = _wait(driver, pace.period_s)
            samples += arrived
        for step in range(-pace.approach_steps, len(course.position)):
            if step in events:
                events[step]()
            started = time.perf_counter()
            if isinstance(controller, Watchful):
                controller.watch(arrived, step)
            pressure = controller.pressure(seen.position, step, seen.tip_force)
            decision_s.append(time.perf_counter() - started)
            driver.command(average.advance(pressure))
            arrived = _wait(driver, pace.period_s)
            samples += arrived
            seen = _seen(samples, course, driver.stale_s) or seen
            _require_alive(samples, robot)
            last.append(seen)
    counted = last[pace.approach_steps :]
    recording = recording_of(samples, robot, name, session)
    pressed = course.pressed(np.stack([sample.tip_force for sample in counted]))
    reached = np.stack([sample.position for sample in counted])
    return Rollout(recording, course, reached, pressed, np.array(decision_s[pace.approach_steps :]))


def _wait(driver: Driver, period_s: float) -> list[Sample]:
    """Return the samples of the next period, of which there must be one to decide on."""
    arrived = driver.advance(period_s)
    if not arrived:
        raise DriverError(f"no sample arrived within {period_s:g} s; nothing to decide on: is the sensor on?")
    return arrived


def _seen(samples: Sequence[Sample], course: Course, stale_s: float) -> Sample | None:
    """Return the last sample with a position, and on a surface with a force; None if there was none yet.

    Raises
    ------
    DriverError
        If that was longer than ``stale_s`` ago.
    """
    found = None
    for sample in reversed(samples):
        if course.is_read(sample.position, sample.tip_force):
            found = sample
            break
    since = samples[0] if found is None else found
    if samples[-1].time_s - since.time_s > stale_s:
        what = "position" if course.frame is None else "position and force"
        raise DriverError(
            f"lost sight of the tip: no {what} for more than {stale_s:g} s, so there is nothing to decide on; what had "
            "arrived is kept: does the camera see the tip?"
        )
    return found


def _require_alive(samples: Sequence[Sample], robot: Robot) -> None:
    """Refuse a camera that shows the same to the last digit while commands move: feedback would take it for a lasting misfit."""
    recent = list(takewhile(lambda sample: sample.time_s > samples[-1].time_s - FROZEN_S, reversed(samples)))
    read = np.stack([sample.position for sample in recent])
    sent = np.stack([sample.commanded for sample in recent[len(recent) // 2 :]])  # what came last may not have moved it yet
    moved = np.ptp(sent, axis=0).max() > MOVED_SHARE * (robot.pressure_max_pa - robot.pressure_min_pa)
    if moved and len(recent) < len(samples) and not np.ptp(read, axis=0).any():
        raise DriverError(
            f"the tip was told at the very same place for {FROZEN_S:g} s, to the last digit, while the commands moved; what had "
            "arrived is kept: has the camera stopped, or is the air off?"
        )
