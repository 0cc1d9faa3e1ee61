"""A chamber whose pressure is off by a constant."""

from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@nb.njit(SIGNAL_KERNEL, cache=True)
def offset_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Shift the acting pressure."""
    chamber = int(parameters[1])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] += parameters[0]


@dataclass(frozen=True)
class Offset(Effect):
    """Constant difference of acting from supplied pressure, as a share of the robot's largest pressure.

    Notes
    -----
    ``p_acting = p + offset p_max`` (no equation number checked).
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "offset of a chamber's pressure"
    kernel: ClassVar = offset_kernel
    exact: ClassVar[bool] = True

    offset: float = parameter("1", -0.5, 0.5, 0.0, typical=0.05)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (offset Pa, chamber)."""
        return super().pack(robot) * [robot.pressure_max_pa, 1.0]
