"""The rollouts of one session at a robot: each controller on each course, from rest."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from softrl.core.driver import Driver
from softrl.core.errors import ConfigError
from softrl.rl.inversion import Plan
from softrl.sim2real.controllers import Models, controllers, prepare
from softrl.sim2real.course import Course
from softrl.sim2real.disturbance import Breakable, Disturbance
from softrl.sim2real.planning import Planning
from softrl.sim2real.rollout import Pace, Rollout, follow

log = logging.getLogger(__name__)
DISTURBED = ("policy", "planned")
LINE_OFF = "_line_off"  # ends the names of runs, and of their session, in which an air line is cut


@runtime_checkable
class Mountable(Protocol):
    """A driver before whose robot a surface can be put without hands."""

    def mount(self, normal: np.ndarray, point: np.ndarray) -> None:
        """Put a surface at ``point`` (3,) m, ``normal`` (3,) towards the robot."""
        ...


@dataclass
class Trial:
    """A robot, what is known of it, and the plans made so far."""

    models: Models
    driver: Driver
    planning: Planning
    pace: Pace
    _plans: dict[str, tuple[Course, Plan]] = field(default_factory=dict)

    def follow(self, course: Course) -> Iterator[tuple[str, Rollout]]:
        """Yield the rollouts of a course by controller; they belong to one session."""
        prepared = prepare(self.models, self.planning, self.pace, course)
        self._plans[course.name] = course, prepared
        made = controllers(self.models, self.planning, self.pace, course, prepared)
        for name, controller in made.items():
            run = f"{course.name}_{name}"
            yield name, follow(self.driver, self.models.robot, controller, course, self.pace, run, course.name)

    def disturbed(self, disturbance: Disturbance) -> Iterator[tuple[str, Rollout]]:
        """Yield rollouts by controller during which an air line is off; its course was followed before."""
        if disturbance.course not in self._plans:
            raise ConfigError(
                f"stage.disturbance.course={disturbance.course} is unknown; expected one of {', '.join(self._plans)}"
            )
        course, prepared = self._plans[disturbance.course]
        driver = self.driver
        assert isinstance(driver, Breakable)
        cut, back = disturbance.steps(len(course.position), self.pace.period_s)
        events = {cut: lambda: driver.cut(disturbance.chamber), back: lambda: driver.cut(None)}
        made = controllers(self.models, self.planning, self.pace, course, prepared)
        for name in DISTURBED:
            run = f"{course.name}_{name}{LINE_OFF}"
            yield name, follow(
                driver, self.models.robot, made[name], course, self.pace, run, f"{course.name}{LINE_OFF}", events
            )


def mount(driver: Driver, models: Models) -> None:
    """Have the task's surface put before the robot, if it has one."""
    if models.surface is None:
        return
    if isinstance(driver, Mountable):
        driver.mount(np.array(models.surface.normal), np.array(models.surface.point))
        return
    where, normal = 1e3 * np.array(models.surface.point), np.array(models.surface.normal)
    log.warning(
        "the surface is expected through (%.2f, %.2f, %.2f) mm, its normal towards the robot (%.4f, %.4f, %.4f)",
        *where, *normal,
    )  # fmt: skip
