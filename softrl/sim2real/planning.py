"""Planned commands on a robot: feedback takes away what the simulation does not know."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError
from softrl.core.span import Span
from softrl.effects.driving import evenly
from softrl.rl.inversion import SHARES, Inversion, Plan, Route
from softrl.rl.running import Run
from softrl.sim2real.course import Course
from softrl.sim2real.watch import LineWatch, Watch

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Planning(Inversion):
    """How commands are planned and corrected.

    Attributes
    ----------
    feedback : share of a new misfit between prediction and reading that is taken as lasting, 0..1
    horizon_steps : commands over which a misfit is taken away
    watch : of the air lines; what a broken one does is not taken as lasting
    """

    key: ClassVar[str] = "stage.planning"

    feedback: float
    horizon_steps: int
    watch: Watch

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.horizon_steps <= 0:
            raise ConfigError(f"{self.key}.horizon_steps={self.horizon_steps:g} must be positive")
        if not 0.0 <= self.feedback <= 1.0:
            raise ConfigError(f"{self.key}.feedback={self.feedback:g}; expected a share between 0 and 1")


class PlannedController:
    """Sends a plan; a misfit between reading and simulation is taken as lasting and taken away by the commands to come.

    The simulation goes along with the robot, under the commands that were sent. What it says of the commands to come, moved
    by the misfit, is led back to the plan by the plan's response; that is sent only as far as the simulation says that it
    helps, since a surface may hold the tip back or let it go on the way. Nothing is learnt from a reading that is older than the
    period: the simulation has gone on since.

    While an air line is broken, and until the tip has forgotten it, the misfit learnt before is kept: commands that make up
    for a line that is off would throw the tip far out once it is back on. The simulation goes on with what the pressure
    sensors tell of that line, so that it knows what the fault leaves behind in walls that creep and remember. What it does
    not know of that has nothing to do with the misfit before: the first readings after it are taken as lasting wholly.

    Parameters
    ----------
    prepared : the plan, whose first ``approach`` steps come before step 0
    route : from requests to the simulation's readings
    course : what is followed
    simulated : from measured pressures (steps, n) Pa to those of the simulation; the same unless given
    """

    def __init__(
        self, prepared: Plan, approach: int, settings: Planning, route: Route, course: Course,
        simulated: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self._plan, self._approach, self._settings, self._route, self._course = prepared, approach, settings, route, course
        self._shadow = Run(route) if settings.feedback > 0.0 else None
        self._change = np.zeros(prepared.request.shape[1])
        self._lasting = np.zeros(3)
        self._lines, self._simulated = LineWatch(settings.watch), simulated
        self._off, self._fresh = np.zeros(prepared.request.shape[1], dtype=bool), True
        self._afresh = 0

    def watch(self, arrived: Sequence[Sample], step: int) -> None:
        """Take in the samples of the period before the command of ``step``; in the approach the robot counts as whole."""
        trusted = self._lines.trusted
        self._lines.advance(arrived, healthy=step <= 0)
        self._fresh = any(self._course.is_read(sample.position, sample.tip_force) for sample in arrived)
        if trusted and not self._lines.trusted:
            log.info("step %d: an air line is off", step)
        if self._lines.trusted and not trusted:
            log.info("step %d: all air lines are on again", step)
            self._afresh = self._settings.watch.afresh_steps
        odd, self._off = self._lines.off | self._off, self._lines.off  # one that is on again has yet to fill
        if self._shadow is not None and odd.any():
            self._shadow.amend(self._measured(arrived, odd))

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return (n,) Pa for the target of ``step`` (negative in the approach), the tip being at ``position`` (3,) m."""
        at = step + self._approach
        planned = self._plan.request[at]
        if self._shadow is None:
            return planned
        if at > 0:
            if self._lines.trusted and self._fresh:
                self._observe(self._course.readings(position, self._course.pressed(tip_force)), self._shadow)
            self._change = self._corrected(at, self._shadow)
        self._shadow.advance(planned + self._change)
        return np.asarray(planned + self._change)

    def _measured(self, arrived: Sequence[Sample], off: np.ndarray) -> Span:
        """Return what stood behind the lines that were ``off`` (hold, n) Pa in the last period, not a number elsewhere."""
        route, pressure = self._route, np.stack([sample.pressure for sample in arrived])
        if self._simulated is not None:
            pressure = self._simulated(pressure)
        age = arrived[-1].time_s - np.array([sample.time_s for sample in arrived])
        end = -route.step_s * np.arange(route.hold - 1, -1, -1)  # of each step, from the end of the period
        return Span(*(np.where(off, evenly(at, -age, pressure), np.nan) for at in (end - 0.5 * route.step_s, end)))

    def _observe(self, reading: np.ndarray, shadow: Run) -> None:
        share = 1.0 if self._afresh > 0 else self._settings.feedback
        self._afresh = max(self._afresh - 1, 0)
        expected = self._route.reading(shadow.tip[None])[0] + self._lasting
        self._lasting += share * (reading - self._course.shown(expected))

    def _corrected(self, at: int, shadow: Run) -> np.ndarray:
        """Return the change (n,) Pa of the requests from ``at`` on."""
        ahead = slice(at, at + self._settings.horizon_steps)
        planned, weight = self._plan.request[ahead], self._settings.bend_weight

        def left(change: np.ndarray) -> np.ndarray:
            """Return by how much (ahead, 3) m the readings to come miss the plan."""
            return self._route.reading(shadow.foresee(planned + change)) + self._lasting - self._plan.predicted[ahead]

        missing = left(self._change)
        turn = self._plan.correction(at, missing, weight)
        for share in SHARES:
            change = self._within(self._change + share * turn, planned[0])
            cost = np.sum(left(change) ** 2) + weight**2 * np.sum((change - self._change) ** 2)
            if cost < np.sum(missing**2):
                return change
        return self._within(self._change, planned[0])

    def _within(self, change: np.ndarray, planned: np.ndarray) -> np.ndarray:
        """Return ``change`` (n,) Pa as far as the robot's range lets it add to ``planned``, or it would wind up."""
        robot = self._route.robot
        return np.asarray(np.clip(planned + change, robot.pressure_min_pa, robot.pressure_max_pa) - planned)
