"""Following targets on a robot: observe, decide, smooth, send, at the pace of the robot's commands (Fig. 6b)."""

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from softrl.core.driver import Driver, Sample
from softrl.core.errors import DriverError
from softrl.recordings.program import recording_of
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from softrl.sim2real.filter import MovingAverage


class Controller(Protocol):
    """Decides on pressures for a sequence of targets that it was made with."""

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return (chambers,) Pa for the target of ``step``, negative while the first target is approached.

        The tip is at ``position`` (3,) m and feels ``tip_force`` (3,) N.
        """
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
    """One sequence of targets, followed.

    Attributes
    ----------
    recording : all samples, approach included
    target : (steps, 3) m
    reached : (steps, 3) m, last reading of the tip before the next command
    decision_s : (steps,) s of real time from reading to pressure
    """

    recording: Recording
    target: np.ndarray
    reached: np.ndarray
    decision_s: np.ndarray

    def error_m(self, wanted: np.ndarray) -> float:
        """Return the root mean square distance, m, between the tip and ``wanted`` (steps, 3) m."""
        return float(np.sqrt(np.mean(np.sum((self.reached - wanted) ** 2, axis=1))))


def follow(
    driver: Driver, robot: Robot, controller: Controller, target: np.ndarray, pace: Pace, name: str, session: str
) -> Rollout:
    """Return how the robot behind ``driver``, which is connected here, follows ``target`` (steps, 3) m.

    The decisions are timed; the robot's clock stands still meanwhile if it is a simulated one, and runs on if not.
    """
    average = MovingAverage(pace.average_window)
    reached, decision_s = [], []
    with driver:
        samples = _wait(driver, [], pace.period_s)
        for step in range(-pace.approach_steps, len(target)):
            started = time.perf_counter()
            pressure = controller.pressure(samples[-1].position, step, samples[-1].tip_force)
            decision_s.append(time.perf_counter() - started)
            driver.command(average.advance(pressure))
            samples = _wait(driver, samples, pace.period_s)
            reached.append(samples[-1].position)
    count = len(target)
    recording = recording_of(samples, robot, name, session)
    return Rollout(recording, target, np.stack(reached[-count:]), np.array(decision_s[-count:]))


def _wait(driver: Driver, samples: list[Sample], period_s: float) -> list[Sample]:
    """Return ``samples`` with those of the next period, of which there must be one to decide on."""
    arrived = driver.advance(period_s)
    if not arrived:
        raise DriverError(f"no sample arrived within {period_s:g} s; nothing to decide on: is the sensor on?")
    return samples + arrived
