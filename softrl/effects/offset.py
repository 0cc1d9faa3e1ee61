"""A chamber whose pressure is off by a constant."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def offset_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Shift the acting pressure, down to the robot's lowest at most."""
    shift, lowest, chamber = parameters[0], parameters[1], int(parameters[2])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] = max(value[i] + shift, min(value[i], lowest))


@dataclass(frozen=True)
class Offset(Effect):
    """Constant difference of acting from supplied pressure, as a share of the robot's largest pressure.

    Notes
    -----
    ``p_acting = max(p + offset p_max, p_min)`` with the robot's smallest pressure p_min, or 0 if that is above it: nothing
    sucks a chamber emptier than its source, and a regulator that is off downwards has a dead zone there (no equation number
    checked).
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "offset of a chamber's pressure"
    gauged: ClassVar[bool] = True
    kernel: ClassVar = offset_kernel
    exact: ClassVar[bool] = True

    offset: float = parameter("1", -0.5, 0.5, 0.0, typical=0.05, of="pressure")
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return an offset downwards: its dead zone is all that a gauge shows, since one may be off by a constant itself."""
        return [{"offset": -0.05}]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (offset Pa, lowest pressure Pa, chamber)."""
        offset, chamber = super().pack(robot)
        return np.array([offset * robot.largest_pa, robot.lowest_pa, chamber])
