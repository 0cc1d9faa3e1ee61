"""A body that never moves, for what lies before it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from softrl.core.simulator import Hook, Motion


@dataclass(frozen=True)
class StillBody:
    """A body that never moves: behind it the valve is simulated alone."""

    @property
    def parameters(self) -> dict[str, float]:
        """None."""
        return {}

    def with_parameters(self, **values: float) -> "StillBody":
        """Return itself."""
        return self

    def reset(self, rng: np.random.Generator | None = None) -> None:
        """Return no state."""

    def step(self, state: Any, pressure: np.ndarray, dt_s: float, *_: Any) -> None:
        """Return no state."""

    def observe(self, state: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the origin."""
        return np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])

    def simulate(
        self,
        time: np.ndarray,
        pressure: np.ndarray,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> Motion:
        """Return no motion under the pressures."""
        quaternion = np.zeros((len(time), 4))
        quaternion[:, 0] = 1.0
        return Motion(time, np.zeros((len(time), 3)), quaternion, pressure)
