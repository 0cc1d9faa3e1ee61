"""What a rollout is to follow: a sequence of tip positions, and on a surface of forces."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from softrl.artifacts.policy import Policy
from softrl.core.config import build, constructor_hints
from softrl.core.errors import ArtifactError
from softrl.rl.tasks.contact import ContactTask
from softrl.rl.tasks.force import Force
from softrl.rl.tasks.hybrid import Hybrid
from softrl.rl.tasks.task import Task
from softrl.rl.tasks.track import Track
from softrl.rl.workspace import Workspace

TASKS: dict[str, Any] = {task.name: task for task in (Track, Force, Hybrid)}


@dataclass(frozen=True)
class Course:
    """Targets, one a command; a closed sequence, so that the targets after the last are the first.

    Attributes
    ----------
    name : of the curve, the task's before it on a surface
    position : (steps, 3) m;  force : (steps,) N, across the surface
    frame : (3, 3) columns along, across the slope's fall, and the normal towards the robot; None in free space
    metres_per_newton : force error that counts as much as a position error of 1 m
    """

    name: str
    position: np.ndarray
    force: np.ndarray
    frame: np.ndarray | None = None
    metres_per_newton: float = 0.0

    @classmethod
    def free(cls, name: str, position: np.ndarray) -> "Course":
        """Return a course (steps, 3) m in free space."""
        return cls(name, position, np.zeros(len(position)))

    def pressed(self, tip_force: np.ndarray | None) -> np.ndarray:
        """Return the force (...,) N across the surface of forces (..., 3) N on the tip."""
        if self.frame is None or tip_force is None:
            return np.zeros(() if tip_force is None else tip_force.shape[:-1])
        return np.asarray(tip_force @ self.frame[:, 2])

    def readings(self, position: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return what is compared with the targets (..., 3) m: the position, or that in the surface and the scaled force."""
        if self.frame is None:
            return position
        along = position @ self.frame[:, :2]
        return np.concatenate([along, self.metres_per_newton * np.asarray(force)[..., None]], axis=-1)

    def is_read(self, position: np.ndarray, tip_force: np.ndarray) -> bool:
        """Return whether a sample's ``position`` (3,) m, and on a surface its ``tip_force`` (3,) N, were measured."""
        return bool(np.isfinite(position).all() and (self.frame is None or np.isfinite(tip_force).all()))

    def shown(self, reading: np.ndarray) -> np.ndarray:
        """Return what sensors show of a reading (3,) m: no force of a surface that the tip does not touch, however near."""
        return reading if self.frame is None else np.array([*reading[:2], max(reading[2], 0.0)])

    @property
    def wanted(self) -> np.ndarray:
        """The readings (steps, 3) m to reach."""
        return self.readings(self.position, self.force)

    def position_error(self, reached: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        """Return the distances (steps,) m of tips (steps, 3) m from the targets, within the surface if there is one."""
        error = reached - (self.position if wanted is None else wanted)
        if self.frame is not None:
            error = error @ self.frame[:, :2]
        return np.asarray(np.linalg.norm(error, axis=1))


def task_of(policy: Policy, shape_steps: int, radius_share: float) -> Task:
    """Return the task that a policy was trained for, with the size of a rollout."""
    if policy.task_name not in TASKS:
        raise ArtifactError(f"the policy was trained for task={policy.task_name}; expected one of {', '.join(TASKS)}")
    kind = TASKS[policy.task_name]
    # policies on a slope from before carry a gain that never did anything there
    idle = {"feedback_gain"} - set(constructor_hints(kind))
    numbers = {key: value for key, value in policy.task.items() if key not in idle}
    made: Task = build(numbers | {"lap_steps": shape_steps, "radius_share": radius_share}, kind, "policy.task")
    return made


def courses(task: Task, space: Workspace) -> Iterator[Course]:
    """Yield the courses of a task's evaluation, which no training saw."""
    for curve in task.curves:
        goals = task.evaluation_goals(curve, space)
        if isinstance(task, ContactTask):
            scale = task.position_scale_m / task.force_scale_n
            name = curve if curve.startswith(task.name) else f"{task.name}_{curve}"
            yield Course(name, goals.position[0], goals.force[0], task.frame(), scale)
        else:
            yield Course(curve, goals.position[0], goals.force[0])
