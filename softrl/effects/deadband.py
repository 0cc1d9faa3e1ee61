"""A regulator that rests while its error is small."""

from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@nb.njit(SIGNAL_KERNEL, cache=True)
def deadband_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Move the supplied pressure only as far as keeps it within the band about the command."""
    band, chamber = parameters[0], int(parameters[1])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            state[i] = min(max(state[i], value[i] - band), value[i] + band)
            value[i] = state[i]


@dataclass(frozen=True)
class Deadband(Effect):
    """Play between command and supply: ``|p - p_cmd| <= band``, a share of the robot's largest pressure.

    Notes
    -----
    Play operator (no equation number checked). A regulator's valves stay shut while the error is within the
    band, and close again once it is back at the band's edge. Independent of rate and step.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "deadband of the pressure regulator"
    kernel: ClassVar = deadband_kernel

    band: float = parameter("1", 0.0, 0.3, 0.0, typical=0.05)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (band Pa, chamber)."""
        return super().pack(robot) * [robot.pressure_max_pa, 1.0]
