"""Follow a curve in free space."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.errors import ConfigError
from softrl.rl.tasks.curves import CURVES
from softrl.rl.tasks.task import TARGET_SEEN, THETA_SEEN, TIP_SEEN, Goals, Seen, Task
from softrl.rl.workspace import Workspace


@dataclass(frozen=True)
class Track(Task):
    """Tip position along closed curves; nothing is touched, so that the force part of the reward is full.

    Attributes
    ----------
    feedback_gain : share of the tip's last deviation from the model that the model-based expert takes back in a step;
        below 1, since a robot that lags deviates on its way as well
    """

    name: ClassVar[str] = "track"
    curves: ClassVar[tuple[str, ...]] = tuple(CURVES)

    feedback_gain: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.feedback_gain <= 1.0:
            raise ConfigError(f"task.feedback_gain={self.feedback_gain:g}; expected a share between 0 and 1")
        if self.alpha == 0.0:
            raise ConfigError(
                "alpha=0 pays task=track for nothing, whatever the tip does; expected more than 0, or task=force or hybrid"
            )

    def evaluation_goals(self, curve: str, space: Workspace) -> Goals:
        """Return circle, star or the 3-D figure-eight about the workspace's centre."""
        shape = CURVES[curve](self.lap_steps)
        position = space.fitted(shape, space.centre, self.radius_share, curve)
        return Goals(position[None], np.zeros((1, self.lap_steps)))

    def training_goals(self, count: int, space: Workspace, rng: np.random.Generator) -> Goals:
        """Return the tip's paths under random Fourier pressures: reachable by themselves, out to the workspace's edge."""
        share = np.stack([random_waves(self, space.surrogate.chambers, rng) for _ in range(count)])
        tip = space.tip_at_share(share.reshape(-1, share.shape[-1])).reshape(count, self.lap_steps, 3)
        return Goals(tip, np.zeros(tip.shape[:2]))

    def answer(self, seen: Seen, space: Workspace) -> np.ndarray:
        """Return what the expert commands (B, 3) when it sees where the tip is.

        Notes
        -----
        What the tip deviates from the model under the command that acts is taken as an offset that stays, and aimed
        against by ``feedback_gain``. In a world that is the model this is the plain inverse.
        """
        deviation = seen.tip - space.twin.tip(seen.theta)
        return self.expert(seen.position - self.feedback_gain * deviation, seen.force, space)

    def seen_by_expert(self) -> np.ndarray:
        """Return the columns of an observation that the expert's answer depends on."""
        return np.array([*TIP_SEEN, *THETA_SEEN, *TARGET_SEEN[:3]])


def random_waves(task: Task, channels: int, rng: np.random.Generator) -> np.ndarray:
    """Return random periodic shares (lap, channels), each swinging over a random part of 0 .. 1."""
    phase = 2.0 * np.pi * np.arange(task.lap_steps)[:, None, None] / task.lap_steps
    order = np.arange(1, task.harmonics + 1)[:, None]
    size, shift = (
        rng.normal(size=(task.harmonics, channels)) / order,
        rng.uniform(0.0, 2.0 * np.pi, (task.harmonics, channels)),
    )
    wave = (size * np.sin(order * phase + shift)).sum(axis=1)
    wave = (wave - wave.min(axis=0)) / np.ptp(wave, axis=0)
    low, high = np.sort(rng.uniform(-0.2, 1.2, (2, channels)), axis=0)  # past the ends, so that the edge is not rare
    return np.clip(low + wave * (high - low), 0.0, 1.0)
