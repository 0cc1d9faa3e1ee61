"""What a controller is asked for: targets, reward and observation; a task of its own is one file beside this one."""

import logging
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from softrl.core.errors import ConfigError
from softrl.rl.reward import weigh
from softrl.rl.tasks.curves import random_fourier
from softrl.rl.workspace import Workspace
from softrl.surrogate.twin import Plane

log = logging.getLogger(__name__)
# columns of an observation, see ``batch.observe``
TIP_SEEN, THETA_SEEN, TARGET_SEEN = (0, 1, 2), (3, 4, 5), (7, 8, 9, 10)


class Seen(NamedTuple):
    """What a controller knows before a step: next targets ``position`` (B, 3) m, ``force`` (B,) N; tip, acting theta (B, 3)."""

    position: np.ndarray
    force: np.ndarray
    tip: np.ndarray
    theta: np.ndarray


class Goals(NamedTuple):
    """Closed target sequences: ``position`` (curves, lap, 3) m and normal ``force`` (curves, lap) N."""

    position: np.ndarray
    force: np.ndarray


@dataclass(frozen=True)
class Task(ABC):
    """Base of all tasks.

    Attributes
    ----------
    alpha : weight of position against force in the reward
    horizon : targets that the controller sees, the one to reach next first; one that learns in a simulator in motion sees
        ``stage.motion.horizon`` of them instead
    episode_steps : steps of a training episode;  lap_steps : targets on a closed curve
    step_s : time between two targets
    radius_share : size of the evaluation curves in the largest that the tip can reach
    harmonics : of the random curves for training
    position_scale_m, force_scale_n : errors at which the steep half of the reward falls to 1/e
    disturbance_n : a training episode has a hidden force on the tip of up to this along each axis, so that the controller
        learns to answer to where the tip is; evaluation is with and without
    """

    name: ClassVar[str]
    curves: ClassVar[tuple[str, ...]]

    alpha: float
    horizon: int
    episode_steps: int
    lap_steps: int
    step_s: float
    radius_share: float
    harmonics: int
    position_scale_m: float
    force_scale_n: float
    disturbance_n: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.alpha <= 1.0:
            raise ConfigError(f"alpha={self.alpha:g}; expected a share between 0 and 1")
        if not 0.0 < self.radius_share <= 1.0:
            raise ConfigError(f"task.radius_share={self.radius_share:g}; expected a share above 0 and at most 1")
        if self.disturbance_n < 0.0:
            raise ConfigError(f"task.disturbance_n={self.disturbance_n:g} must not be negative")
        if self.lap_steps < 3:
            raise ConfigError(f"task.lap_steps={self.lap_steps}; expected 3 or more targets on a closed curve")
        for key in (
            "horizon",
            "episode_steps",
            "step_s",
            "harmonics",
            "position_scale_m",
            "force_scale_n",
        ):
            if getattr(self, key) <= 0:
                raise ConfigError(f"task.{key}={getattr(self, key):g} must be positive")

    @abstractmethod
    def evaluation_goals(self, curve: str, space: Workspace) -> Goals:
        """Return one evaluation curve, which training never sees."""

    @abstractmethod
    def training_goals(self, count: int, space: Workspace, rng: np.random.Generator) -> Goals:
        """Return ``count`` random curves."""

    def check_forces(self, tip_force_max_n: float, space: Workspace) -> None:
        """Warn of hidden forces above what the robot's tip is made for, ``tip_force_max_n``."""
        if self.disturbance_n > tip_force_max_n:
            log.warning(
                "task.disturbance_n=%g hides forces on a tip that is made for %g N (robot.tip_force_max_n): lower it",
                self.disturbance_n, tip_force_max_n,
            )  # fmt: skip

    def plane(self, space: Workspace) -> Plane | None:
        """Return the surface that the tip may touch, its normal towards the robot."""
        return None

    @property
    def friction(self) -> float:
        """Coulomb's coefficient of that surface."""
        return 0.0

    def ground(self, plane: Plane | None, size: int, rng: np.random.Generator) -> tuple[Plane | None, float | np.ndarray]:
        """Return what ``size`` tips touch where they are: the plane, and its friction, one or (size,)."""
        return plane, self.friction

    @property
    def force_unit_n(self) -> float:
        """Force that counts as 1 in observations."""
        return 1.0

    def position_error(self, tip: np.ndarray, target: np.ndarray, plane: Plane | None) -> np.ndarray:
        """Return the distances (B,) m of tips (B, 3) from targets; within the plane where there is one.

        A tip that presses on a surface sinks into it by the force over the contact's stiffness; that is the force's
        business, not the position's.
        """
        error = tip - target
        if plane is not None:
            error = error - (error @ plane[0])[:, None] * plane[0]
        return np.linalg.norm(error, axis=1)

    def reward(self, position_error: np.ndarray, force_error: np.ndarray) -> np.ndarray:
        """Return R (B,) in 0 .. 1 of errors (B,) m and N; targets come in sequence, each step has its own."""
        return weigh(self.alpha, position_error, force_error, self.position_scale_m, self.force_scale_n)

    def expert(self, position: np.ndarray, force: np.ndarray, space: Workspace) -> np.ndarray:
        """Return the commands (B, 3) that a model-based controller gives for targets (B, 3) m and forces (B,) N."""
        return space.twin.joints_for_tip(position)

    @abstractmethod
    def answer(self, seen: Seen, space: Workspace) -> np.ndarray:
        """Return what the expert commands (B, 3) when it sees where the tip is."""

    @abstractmethod
    def seen_by_expert(self) -> np.ndarray:
        """Return the columns of an observation that the expert's answer depends on."""

    def record(self) -> dict[str, Any]:
        """Return the task's numbers as plain values."""
        return asdict(self)


def fourier_positions(
    count: int,
    task: Task,
    space: Workspace,
    frame: np.ndarray,
    centre: np.ndarray,
    height: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return random reachable curves (count, lap, 3) m about ``centre`` (3,) m in the axes ``frame`` (3, 3) (columns)."""
    curves = np.empty((count, task.lap_steps, 3))
    for i in range(count):
        shape = random_fourier(task.lap_steps, task.harmonics, height, rng) @ frame.T
        size = space.largest(shape, centre) * rng.uniform(0.5, 1.0)
        curves[i] = centre + size * shape
    return curves
