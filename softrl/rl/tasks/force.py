"""Press on a slope at one point with a force that changes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.rl.tasks.contact import ContactTask
from softrl.rl.tasks.curves import random_fourier
from softrl.rl.tasks.task import Goals
from softrl.rl.workspace import Workspace

FORCES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "force_sine": lambda s: 0.5 - 0.5 * np.cos(2.0 * np.pi * s),
    "force_steps": lambda s: np.floor(4.0 * s) / 3.0,
    "force_ramp": lambda s: 1.0 - np.abs(2.0 * s - 1.0),
}
SPREAD = 0.5  # training presses at points up to this share of the reachable radius from the centre


@dataclass(frozen=True)
class Force(ContactTask):
    """Normal force at a fixed point of the slope."""

    name: ClassVar[str] = "force"
    curves: ClassVar[tuple[str, ...]] = tuple(FORCES)

    def evaluation_goals(self, curve: str, space: Workspace) -> Goals:
        """Return a force that rises and falls over the whole range, at the workspace's centre."""
        share = FORCES[curve](np.arange(self.lap_steps) / self.lap_steps)
        force = self.force_min_n + (self.force_max_n - self.force_min_n) * share
        return Goals(np.tile(space.centre, (1, self.lap_steps, 1)), force[None])

    def training_goals(self, count: int, space: Workspace, rng: np.random.Generator) -> Goals:
        """Return random forces at random points of the slope about the centre."""
        self.require_reach(space)
        frame = self.frame()
        position = np.empty((count, self.lap_steps, 3))
        for i in range(count):
            angle = rng.uniform(0.0, 2.0 * np.pi)
            direction = frame[:, :2] @ [np.cos(angle), np.sin(angle)]
            reach = space.largest(direction[None], space.centre)
            position[i] = space.centre + SPREAD * reach * np.sqrt(rng.uniform()) * direction
        return Goals(position, np.stack([random_force(self, rng) for _ in range(count)]))


def random_force(task: ContactTask, rng: np.random.Generator) -> np.ndarray:
    """Return a random periodic force (lap,) N within the task's range."""
    wave = random_fourier(task.lap_steps, task.harmonics, 1.0, rng)[:, 0]
    share = 0.5 + 0.5 * (wave - wave.mean()) / np.abs(wave - wave.mean()).max()
    return task.force_min_n + (task.force_max_n - task.force_min_n) * share
