"""A chamber that balloons: the more it is inflated, the more each further pascal does."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def area_growth_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Scale each pressure by ``1 + growth |p| / p_max``."""
    chamber = int(parameters[2])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] *= 1.0 + parameters[0] * abs(value[i]) / parameters[1]


@dataclass(frozen=True)
class AreaGrowth(Effect):
    """Acting pressure ``p (1 + growth |p| / p_max)``: an effective area that grows (or shrinks) with pressure.

    Notes
    -----
    First term of an expansion, static and without memory (no equation number checked). In motion alone it looks
    like a wall that softens with strain; a tip force at constant pressure tells the two apart.
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "growth of a chamber's effective area with pressure"
    kernel: ClassVar = area_growth_kernel
    of_area: ClassVar[bool] = True

    growth: float = parameter("1", -0.5, 20.0, 0.0, typical=1.0)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (growth, largest pressure Pa, chamber)."""
        growth, chamber = super().pack(robot)
        return np.array([growth, robot.largest_pa, chamber])
