"""A chamber that acts otherwise above some pressure: its wall buckles, or meets its neighbour."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def knee_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Scale what each pressure exceeds the threshold by."""
    chamber = int(parameters[2])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            beyond = max(abs(value[i]) - parameters[1], 0.0)
            value[i] += (parameters[0] - 1.0) * math.copysign(beyond, value[i])


@dataclass(frozen=True)
class Knee(Effect):
    """Acting pressure ``p`` up to the threshold, and ``slope`` times as steep beyond it, both ways.

    ``threshold`` is a share of the robot's largest pressure.

    Notes
    -----
    Piecewise linear, static, without memory (no equation number checked). Nothing happens in recordings that stay below
    the threshold.
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "change of a chamber's effect above a pressure"
    kernel: ClassVar = knee_kernel
    above_own: ClassVar[bool] = True
    of_area: ClassVar[bool] = True
    gauged: ClassVar[bool] = True
    variant_of: ClassVar[str] = "area_growth"
    extends: ClassVar[str] = "supply_limit"

    slope: float = parameter("1", 0.0, 4.0, 1.0, typical=0.5)
    threshold: float = parameter("1", 0.05, 0.95, 0.5, typical=0.5, of="pressure")
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (slope, threshold Pa, chamber)."""
        return super().pack(robot) * [1.0, robot.largest_pa, 1.0]
