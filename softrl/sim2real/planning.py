"""Planned commands on a robot: feedback takes away what the simulation does not know."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError
from softrl.rl.inversion import Inversion, Plan
from softrl.robots.robot import Robot
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

    feedback: float
    horizon_steps: int
    watch: Watch

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.horizon_steps <= 0:
            raise ConfigError(f"planning.horizon_steps={self.horizon_steps:g} must be positive")
        if not 0.0 <= self.feedback <= 1.0:
            raise ConfigError(f"planning.feedback={self.feedback:g}; expected a share between 0 and 1")


class PlannedController:
    """Sends a plan; a misfit between reading and prediction is taken as lasting and taken away by the commands to come.

    While an air line is broken, and until the tip has forgotten it, the misfit learnt before is kept: commands that make up
    for a line that is off would throw the tip far out once it is back on. What the fault leaves behind, in walls that creep
    and remember, has nothing to do with the misfit before: the first readings after it are taken as lasting wholly.

    Parameters
    ----------
    prepared : the plan, whose first ``approach`` steps come before step 0
    read : reading (3,) m from the tip's position (3,) m and the force on it (3,) N
    """

    def __init__(
        self, prepared: Plan, approach: int, settings: Planning, robot: Robot,
        read: Callable[[np.ndarray, np.ndarray | None], np.ndarray],
    ) -> None:
        self._plan, self._approach, self._settings, self._robot, self._read = prepared, approach, settings, robot, read
        self._change = np.zeros_like(prepared.request)
        self._lasting = np.zeros(3)
        self._lines = LineWatch(settings.watch)
        self._afresh = 0

    def watch(self, arrived: Sequence[Sample], step: int) -> None:
        """Take in the samples of the period before the command of ``step``; in the approach the robot counts as whole."""
        trusted = self._lines.trusted
        self._lines.advance(arrived, healthy=step <= 0)
        if trusted and not self._lines.trusted:
            log.info("step %d: an air line is off", step)
        if self._lines.trusted and not trusted:
            log.info("step %d: all air lines are on again", step)
            self._afresh = self._settings.watch.afresh_steps

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return (n,) Pa for the target of ``step`` (negative in the approach), the tip being at ``position`` (3,) m."""
        at = step + self._approach
        if at > 0 and self._settings.feedback > 0.0:
            if self._lines.trusted:
                self._observe(at - 1, self._read(position, tip_force))
            self._correct(at)
        return np.asarray(self._plan.request[at] + self._change[at])

    def _observe(self, k: int, reading: np.ndarray) -> None:
        expected = self._plan.predicted[k] + self._plan.effect(self._change, k)
        share = 1.0 if self._afresh > 0 else self._settings.feedback
        self._afresh = max(self._afresh - 1, 0)
        self._lasting += share * (reading - expected - self._lasting)

    def _correct(self, at: int) -> None:
        """Choose the changes from ``at`` on; those beyond the horizon keep the last one's value."""
        change, limits = self._change, (self._robot.pressure_min_pa, self._robot.pressure_max_pa)
        ahead = min(self._settings.horizon_steps, len(change) - at)
        wanted = self._plan.corrected(change, at, np.tile(self._lasting, (ahead, 1)), self._settings.bend_weight)
        planned = self._plan.request[at : at + ahead]
        # a correction never asks for more than the robot may have, or it would wind up
        change[at : at + ahead] = np.clip(planned + wanted, *limits) - planned
        change[at + ahead :] = change[at + ahead - 1]
