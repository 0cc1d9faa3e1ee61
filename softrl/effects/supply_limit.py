"""A source that cannot reach the pressures a robot may be sent."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def supply_limit_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Clip the supplied pressure at ceiling and floor."""
    chamber = int(parameters[2])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] = min(max(value[i], parameters[1]), parameters[0])


@dataclass(frozen=True)
class SupplyLimit(Effect):
    """Ceiling and floor of the supplied pressure, as shares of the robot's highest and lowest pressure.

    A robot without suction (``pressure_min_pa >= 0``) has no floor, one with nothing else (``pressure_max_pa <= 0``) no ceiling.

    Notes
    -----
    ``p = min(max(p_cmd, floor), ceiling)`` (no equation number checked).
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "saturation of the supply pressure"
    kernel: ClassVar = supply_limit_kernel
    above_own: ClassVar[bool] = True

    ceiling: float = parameter("1", 0.1, 1.0, 1.0, typical=0.6, of="ceiling")
    floor: float = parameter("1", 0.0, 1.0, 1.0, typical=0.6)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (ceiling Pa, floor Pa, chamber); a share of 1 clips nothing."""
        ceiling, floor, chamber = super().pack(robot)
        high = ceiling * robot.pressure_max_pa if ceiling < 1.0 and robot.pressure_max_pa > 0.0 else np.inf
        low = floor * robot.pressure_min_pa if floor < 1.0 and robot.pressure_min_pa < 0.0 else -np.inf
        return np.array([high, low, chamber])
