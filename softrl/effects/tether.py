"""A hose or cable that pulls at the tip."""

from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import FORCE, FORCE_SLOPE, PORT_KERNEL, TIP, Effect, parameter
from softrl.robots.robot import Robot


@nb.njit(PORT_KERNEL, cache=True)
def tether_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Pull the tip towards the point where the hose would rest."""
    for k in range(3):
        port[FORCE, k] -= parameters[0] * (port[TIP, k] - parameters[1 + k])
        port[FORCE_SLOPE + k, k] -= parameters[0]


@dataclass(frozen=True)
class Tether(Effect):
    """Pull ``F = -k (tip - anchor)`` to a point beside the tip at rest; offsets in lengths of the robot.

    Notes
    -----
    Linear spring (no equation number checked); a hose that goes slack would pull one way only.
    """

    site: ClassVar[str] = "load"
    title: ClassVar[str] = "pull of a hose or cable at the tip"
    kernel: ClassVar = tether_kernel

    stiffness_n_per_m: float = parameter("N/m", 0.0, 500.0, 0.0, typical=30.0)
    offset_x: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    offset_y: float = parameter("1", -0.5, 0.5, 0.0, typical=0.0)

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (stiffness N/m, anchor (3,) m)."""
        anchor = robot.length_m * np.array([self.offset_x, self.offset_y, 1.0])
        return np.array([self.stiffness_n_per_m, *anchor])
