"""A sensor that is read less often than it is recorded."""

from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@nb.njit(SIGNAL_KERNEL, cache=True)
def hold_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Take a new pose once in ``period_s`` and repeat it in between."""
    if state[0] <= 1e-6 * dt:
        state[0] = max(state[0] + parameters[0], 0.0)
        for i in range(len(value)):
            state[1 + i] = value[i]
    state[0] -= dt
    for i in range(len(value)):
        value[i] = state[1 + i]


@dataclass(frozen=True)
class Hold(Effect):
    """Sample-and-hold of the reported pose: a staircase, half a period late on average.

    Notes
    -----
    Zero-order hold, ``x(t) = pose(period floor(t / period))`` (textbook form, no equation number checked).
    """

    site: ClassVar[str] = "sensor"
    title: ClassVar[str] = "sample-and-hold of the pose sensor"
    kernel: ClassVar = hold_kernel

    period_s: float = parameter("s", 0.0, 1.0, 0.0, typical=0.15)

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the time to the next reading and the pose held."""
        return np.zeros(8)
