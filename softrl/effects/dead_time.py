"""Transport: what is commanded arrives unchanged, some time later."""

from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.history import empty_history, look_back, push
from softrl.robots.robot import Robot


@nb.njit(SIGNAL_KERNEL, cache=True)
def dead_time_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Replace the command by the one ``delay_s`` ago; before the start it was zero."""
    push(state, value, False)
    chamber = int(parameters[1])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] = look_back(state, len(value), i, parameters[0] / dt)


@dataclass(frozen=True)
class DeadTime(Effect):
    """Pure delay between command and supply, ``p(t) = p_cmd(t - delay)``.

    Notes
    -----
    Textbook transport delay of a line (no equation number checked). Exact for a delay of whole steps,
    interpolated linearly between; the step must exceed delay / 4094.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "dead time between command and supplied pressure"
    kernel: ClassVar = dead_time_kernel
    exact: ClassVar[bool] = True
    shifts_time: ClassVar[bool] = True

    delay_s: float = parameter("s", 0.0, 1.0, 0.0, typical=0.1)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return an empty history."""
        return empty_history(robot.chambers)
