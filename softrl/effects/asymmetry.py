"""Chambers that do not act alike, because the body was not made true."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def asymmetry_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Scale each chamber's pressure by a factor of its own."""
    for i in range(len(value)):
        value[i] *= parameters[i]


@dataclass(frozen=True)
class Asymmetry(Effect):
    """Gain of each chamber by its direction ``d``: ``1 + along_x d_x + along_y d_y``.

    Notes
    -----
    First harmonic of a wall that is thicker on one side (no equation number checked): equal pressures bend the body off
    its axis, static and repeatable. One chamber alone that is off is ``gain``.
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "asymmetry of the chambers"
    kernel: ClassVar = asymmetry_kernel
    of_area: ClassVar[bool] = True

    along_x: float = parameter("1", -0.8, 0.8, 0.0, typical=0.15)
    along_y: float = parameter("1", -0.8, 0.8, 0.0, typical=0.1)

    def pack(self, robot: Robot) -> np.ndarray:
        """Return the chambers' gains."""
        return 1.0 + np.asarray(robot.chamber_direction @ [self.along_x, self.along_y])

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether chambers can differ."""
        return robot.chambers > 1
