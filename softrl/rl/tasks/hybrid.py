"""Follow a curve on a slope while pressing on it."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.rl.tasks.contact import ContactTask
from softrl.rl.tasks.curves import CURVES
from softrl.rl.tasks.force import random_force
from softrl.rl.tasks.task import Goals, fourier_positions
from softrl.rl.workspace import Workspace


@dataclass(frozen=True)
class Hybrid(ContactTask):
    """Contact point along closed curves in the slope, and normal force, both at once."""

    name: ClassVar[str] = "hybrid"
    curves: ClassVar[tuple[str, ...]] = tuple(CURVES)

    def evaluation_goals(self, curve: str, space: Workspace) -> Goals:
        """Return circle, star or figure-eight laid flat on the slope, the force swinging about its mean."""
        shape = CURVES[curve](self.lap_steps) * [1.0, 1.0, 0.0] @ self.frame().T
        position = space.fitted(shape, space.centre, self.radius_share, curve)
        swing = 0.5 + 0.25 * np.sin(4.0 * np.pi * np.arange(self.lap_steps) / self.lap_steps)
        force = self.force_min_n + (self.force_max_n - self.force_min_n) * swing
        return Goals(position[None], force[None])

    def training_goals(self, count: int, space: Workspace, rng: np.random.Generator) -> Goals:
        """Return random Fourier curves in the slope with random forces."""
        self.require_reach(space)
        position = fourier_positions(count, self, space, self.frame(), space.centre, 0.0, rng)
        return Goals(position, np.stack([random_force(self, rng) for _ in range(count)]))
