"""A sensor that reports what was, not what is."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.history import empty_history, look_back, push
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def delay_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Replace the pose by the one ``delay_s`` ago; before the start the body was where it started."""
    push(state, value, True)
    if parameters[0] <= 0.0:
        return
    for i in range(len(value)):
        value[i] = look_back(state, len(value), i, parameters[0] / dt)
    norm = math.sqrt(value[3] ** 2 + value[4] ** 2 + value[5] ** 2 + value[6] ** 2)
    for i in range(3, 7):
        value[i] /= norm


@dataclass(frozen=True)
class Delay(Effect):
    """Pure delay of the reported pose, exact for whole steps; steps shorter than delay / 4094 are refused.

    Notes
    -----
    ``x(t) = pose(t - delay)`` (textbook transport delay, no equation number checked).
    """

    site: ClassVar[str] = "sensor"
    title: ClassVar[str] = "delay of the pose sensor"
    kernel: ClassVar = delay_kernel
    exact: ClassVar[bool] = True
    shifts_time: ClassVar[bool] = True

    delay_s: float = parameter("s", 0.0, 1.0, 0.0, typical=0.1)

    def reset(self, robot: Robot) -> np.ndarray:
        """Return an empty history of poses."""
        return empty_history(7)
