"""What the two tasks on a surface share: a slope across the workspace, its friction, forces, and the expert."""

import logging
from abc import ABC
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from softrl.core.errors import ConfigError
from softrl.rl.tasks.task import TARGET_SEEN, TIP_SEEN, Seen, Task
from softrl.rl.workspace import SMALLEST_SHARE, Workspace
from softrl.surrogate.twin import Plane

log = logging.getLogger(__name__)
EXPERT_ITERATIONS, FOUND_M = 40, 1e-6  # turns of the search, and the miss that ends it
LEFT = 0.3  # of a miss, after a step that took the force past what is wanted: with more the step was too long
GROUND_SEED, GROUND_CURVES, GROUND_EVERY, PATCHES = 0, 4, 8, 12  # where the expert weighs position against force
WANTED, ASKED = 18, 49  # and the forces that it tries there


@dataclass(frozen=True)
class ContactTask(Task, ABC):
    """Base of the tasks on a slope.

    Attributes
    ----------
    slope_deg : tilt of the surface about the y axis;  friction_coefficient : Coulomb's
    force_min_n, force_max_n : range of the wanted normal force
    roughness_m, friction_spread : by how much at most the slope's height, and as a share its friction, are off the values
        above; drawn anew for every step (patches smaller than one), known to no controller
    """

    slope_deg: float
    friction_coefficient: float
    force_min_n: float
    force_max_n: float
    roughness_m: float
    friction_spread: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.force_min_n < self.force_max_n:
            raise ConfigError(
                f"task.force_min_n={self.force_min_n:g}, force_max_n={self.force_max_n:g}; expected 0 < min < max"
            )
        if not abs(self.slope_deg) < 60.0:
            raise ConfigError(f"task.slope_deg={self.slope_deg:g}; expected less than 60")
        if self.friction_coefficient < 0.0:
            raise ConfigError(f"task.friction_coefficient={self.friction_coefficient:g} must not be negative")
        if self.roughness_m < 0.0:
            raise ConfigError(f"task.roughness_m={self.roughness_m:g} must not be negative")
        if not 0.0 <= self.friction_spread <= 1.0:
            raise ConfigError(f"task.friction_spread={self.friction_spread:g}; expected a share between 0 and 1")

    @property
    def friction(self) -> float:
        """Coulomb's coefficient of the slope."""
        return self.friction_coefficient

    @property
    def force_unit_n(self) -> float:
        """The largest wanted force."""
        return self.force_max_n

    def frame(self) -> np.ndarray:
        """Return the slope's axes (3, 3) as columns: along it, across it, and its normal towards the robot, below it."""
        tilt = np.deg2rad(self.slope_deg)
        along = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
        normal = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
        return np.column_stack([along, np.cross(normal, along), normal])

    def require_reach(self, space: Workspace) -> None:
        """Raise ``ConfigError`` if the tip cannot move over the slope: a circle on it must have some size."""
        angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
        circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)]) @ self.frame().T
        radius = space.largest(circle, space.centre)
        if radius < SMALLEST_SHARE * space.scale:
            raise ConfigError(
                f"task.slope_deg={self.slope_deg:g}: the tip reaches {1e3 * radius:.2g} mm about the workspace's centre "
                f"on that slope; expected {1e3 * SMALLEST_SHARE * space.scale:.2g} mm or more: choose a flatter one"
            )

    def check_forces(self, tip_force_max_n: float, space: Workspace) -> None:
        """Refuse wanted forces above what the robot's tip is made for; warn where a vented robot presses harder.

        Raises
        ------
        ConfigError
            If the largest wanted force is larger than ``tip_force_max_n``.
        """
        super().check_forces(tip_force_max_n, space)
        if self.force_max_n > tip_force_max_n:
            raise ConfigError(
                f"task.force_max_n={self.force_max_n:g} is more than the tip is made for; expected at most "
                f"robot.tip_force_max_n={tip_force_max_n:g}"
            )
        vented = float(space.twin.solve(space.rest[None], None, self.plane(space), refuse=False).contact_force[0])
        if vented > tip_force_max_n:
            log.warning(
                "without pressure the tip presses on task=%s's slope with %.2g N, more than robot.tip_force_max_n=%g: "
                "take the slope away before the robot is vented",
                self.name, vented, tip_force_max_n,
            )  # fmt: skip

    def plane(self, space: Workspace) -> Plane:
        """Return the slope through the workspace's centre."""
        return self.frame()[:, 2], space.centre

    @property
    def certain(self) -> bool:
        """Whether the slope is what the controllers are told that it is."""
        return self.roughness_m == 0.0 and self.friction_spread == 0.0

    def ground(
        self, plane: Plane | None, size: int, rng: np.random.Generator
    ) -> tuple[Plane | None, float | np.ndarray]:
        """Return the slope and its friction where ``size`` tips touch it, each at a patch of its own."""
        if plane is None or self.certain:
            return plane, self.friction
        height, grip = rng.uniform(-1.0, 1.0, (2, size))
        normal, point = plane
        return (normal, point + self.roughness_m * height[:, None] * normal), self.friction * (
            1.0 + self.friction_spread * grip
        )

    def seen_by_expert(self) -> np.ndarray:
        """Return the columns of an observation that the expert's answer depends on."""
        return np.array([*TIP_SEEN, *TARGET_SEEN])

    def answer(self, seen: Seen, space: Workspace) -> np.ndarray:
        """Return what the expert commands (B, 3) when it sees where the tip is, from which it slides.

        Notes
        -----
        On a slope that is what it is told to be, force and position are both met, whatever ``alpha`` is. Where friction
        is not known, what it does to the tip grows with the force: how hard it pays to press is a matter of ``alpha``.
        """
        force = seen.force if self.certain else np.interp(seen.force, *_worthwhile(self, space))
        return self._commands(seen.position, force, space, seen.tip)

    def expert(self, position: np.ndarray, force: np.ndarray, space: Workspace) -> np.ndarray:
        """Return commands (B, 3) for contact points (B, 3) m and forces (B,) N, blind to the tip: without friction."""
        return self._commands(position, force, space, None)

    def _commands(
        self, position: np.ndarray, force: np.ndarray, space: Workspace, start: np.ndarray | None
    ) -> np.ndarray:
        """Return commands (B, 3) whose loaded equilibrium has the wanted contact point and normal force.

        Notes
        -----
        The free tip is aimed behind the surface and corrected by the errors of the twin's equilibrium: along the surface
        by the position's error, across it by the force's error over the stiffness of tip and contact in series. A tip that
        friction holds is stiffer than that, the more so the less a body yields along itself: steps that go too far are halved,
        and grow again. Friction counts if the tips (B, 3) m are known that it holds back, ``start``; the best aim is taken.
        """
        plane = self.plane(space)
        normal, twin = plane[0], space.twin
        friction = 0.0 if start is None else self.friction
        soft = 1.0 / twin.contact_stiffness + twin.softness(space.rest[None], normal)[0]
        aim = position - (force * soft)[:, None] * normal
        best, lowest, last, gain = aim.copy(), *np.full((2, len(aim)), np.inf), np.ones(len(aim))
        lacked = np.zeros(len(aim))
        for _ in range(EXPERT_ITERATIONS):
            rows = np.flatnonzero(lowest > FOUND_M)
            if not len(rows):
                break
            held = None if start is None else start[rows]
            state = twin.solve(twin.joints_for_tip(aim[rows]), None, plane, friction, held, refuse=False)
            error = position[rows] - state.tip
            error = error - (error @ normal)[:, None] * normal
            lacking = force[rows] - state.contact_force
            miss = np.linalg.norm(error, axis=1) + soft * np.abs(lacking)
            nearer = rows[miss < lowest[rows]]
            best[nearer] = aim[nearer]
            lowest[rows] = np.minimum(miss, lowest[rows])
            too_far = (miss > last[rows]) | ((lacking * lacked[rows] < 0.0) & (miss > LEFT * last[rows]))
            gain[rows] = np.minimum(gain[rows] * np.where(too_far, 0.5, 1.2), 1.0)
            last[rows], lacked[rows] = miss, lacking
            aim[rows] += gain[rows, None] * (error - (lacking * soft)[:, None] * normal)
        return twin.joints_for_tip(best)


@lru_cache(maxsize=8)
def _worthwhile(task: ContactTask, space: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Return wanted forces (k,) N and, for each, the force (k,) N that the expert does best to ask for.

    Notes
    -----
    Best is the largest mean reward (eq. 21) over steps of random curves, each on several patches of the slope.
    """
    rng = np.random.default_rng(GROUND_SEED)
    lap = task.training_goals(GROUND_CURVES, space, rng).position
    start, position = (np.roll(lap, shift, axis=1)[:, ::GROUND_EVERY].reshape(-1, 3) for shift in (1, 0))
    wanted = np.linspace(task.force_min_n, task.force_max_n, WANTED)
    asked = np.linspace(0.0, 1.2 * task.force_max_n, ASKED)
    plane, grip = task.ground(task.plane(space), PATCHES * len(position), rng)
    mean = np.empty((ASKED, WANTED))
    for row, force in zip(mean, asked, strict=True):
        theta = np.repeat(task._commands(position, np.full(len(position), force), space, start), PATCHES, axis=0)
        state = space.twin.solve(theta, None, plane, grip, np.repeat(start, PATCHES, axis=0), refuse=False)
        near = task.position_error(state.tip, np.repeat(position, PATCHES, axis=0), task.plane(space))
        row[:] = [task.reward(near, np.abs(state.contact_force - f)).mean() for f in wanted]
    return wanted, asked[mean.argmax(axis=0)]
