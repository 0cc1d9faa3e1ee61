"""From a reading of the tip to pressures: by the policy with the calibration, or by a model alone."""

from collections.abc import Sequence

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.calibration.pressure_map import PressureMap
from softrl.core.driver import Sample
from softrl.core.errors import ArtifactError
from softrl.rl.inference import Inference
from softrl.rl.tasks.task import Task
from softrl.rl.workspace import Workspace
from softrl.sim2real.course import Course
from softrl.sim2real.rollout import Controller, Watchful
from softrl.sim2real.watch import LineWatch, Watch
from softrl.surrogate.maps import PressureToJoints


class PolicyController:
    """Observation -> policy -> joints -> inverse of f_SP -> P_S -> inverse of f_RS -> P_R (Fig. 6b).

    Parameters
    ----------
    calibration : left out for a policy that was trained on a corrected simulator, which takes the robot's own pressures
    course : what it follows
    settings : of the watch over the air lines, for a policy with a memory: while one is broken, and until the tip has
        forgotten it, the policy is told that the tip is where it was to be, or it would wind up against what no command can
        mend and throw the tip far out once the line is back
    """

    def __init__(
        self, policy: Policy, surrogate: Surrogate, calibration: Calibration, course: Course, settings: Watch | None = None
    ) -> None:
        require_match(surrogate, calibration)
        self._chain, self._course = Inference(policy, surrogate, None if policy.corrected else calibration), course
        self._lines = LineWatch(settings) if settings is not None and policy.memory else None

    def watch(self, arrived: Sequence[Sample], step: int) -> None:
        """Take in the samples of the period before the command of ``step``; in the approach the robot counts as whole."""
        if self._lines is not None:
            self._lines.advance(arrived, healthy=step <= 0)

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return P_R (chambers,) Pa for the target of ``step``, the tip being at ``position`` (3,) m."""
        course = self._course
        ahead = np.maximum(step + np.arange(self._chain.horizon), 0) % len(course.position)
        pressed = float(course.pressed(tip_force))
        if self._lines is not None and not self._lines.trusted:
            position = course.position[max(step - 1, 0)]
        return self._chain.pressure(position, pressed, course.position[ahead], course.force[ahead])


class ModelController:
    """The surrogate's inverse for each target, sent as if the robot were the simulator: no feedback, no calibration."""

    def __init__(self, space: Workspace, task: Task, course: Course) -> None:
        theta = task.expert(course.position, course.force, space)
        self._pressure = PressureToJoints(space.surrogate).pressure(theta)

    @property
    def pressures(self) -> np.ndarray:
        """All pressures P_S (steps, chambers) Pa."""
        return self._pressure

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return P_S (chambers,) Pa for the target of ``step``; ``position`` is not looked at."""
        return np.asarray(self._pressure[max(step, 0)])


class Calibrated:
    """Another controller's P_S, sent as P_R by the inverse of f_RS."""

    def __init__(self, inner: Controller, calibration: Calibration) -> None:
        self._inner, self._map = inner, PressureMap(calibration)

    def watch(self, arrived: Sequence[Sample], step: int) -> None:
        """Let the other look at the samples, which are of the robot's own pressures."""
        if isinstance(self._inner, Watchful):
            self._inner.watch(arrived, step)

    def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
        """Return P_R (chambers,) Pa of the other's P_S."""
        return np.asarray(self._map.sim_to_real(self._inner.pressure(position, step, tip_force)))


def require_match(surrogate: Surrogate, calibration: Calibration) -> None:
    """Raise unless both artifacts belong to robots of as many chambers, and f_RS to the simulator without effects."""
    if calibration.effects:
        raise ArtifactError(
            f"inputs.calibration maps what a simulator with {', '.join(calibration.effects)} leaves; sim2real takes that of "
            "the nominal one: run stage=calibration without effect="
        )
    if surrogate.chambers != calibration.chambers:
        raise ArtifactError(
            f"Surrogate has {surrogate.chambers} chambers, Calibration {calibration.chambers}; "
            "run stage=calibration again"
        )
