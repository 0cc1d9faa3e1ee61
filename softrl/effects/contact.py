"""A wall that the tip may touch."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, TURN, Effect, parameter
from softrl.effects.port import FORCE, FORCE_SLOPE, TIP
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def contact_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Push the tip back along the wall's normal in proportion to its depth."""
    depth = -parameters[3]
    for k in range(3):
        depth += parameters[k] * port[TIP, k]
    if depth <= 0.0:
        return
    for j in range(3):
        port[FORCE, j] -= parameters[4] * depth * parameters[j]
        for k in range(3):
            port[FORCE_SLOPE + j, k] -= parameters[4] * parameters[j] * parameters[k]


@dataclass(frozen=True)
class Contact(Effect):
    """Elastic, frictionless plane that the tip meets: upright, unless ``elevation_rad`` turns its normal up.

    ``distance`` is that from the base's origin along the normal, in lengths of the robot; at 2 it is out of
    reach.

    Notes
    -----
    Penalty contact, ``F = k max(depth, 0)`` against the normal (textbook form, no equation number checked).
    """

    site: ClassVar[str] = "load"
    title: ClassVar[str] = "contact of the tip with a plane"
    kernel: ClassVar = contact_kernel

    distance: float = parameter("1", 0.0, 2.0, 2.0, typical=0.1, of="length")
    azimuth_rad: float = parameter("rad", -TURN, TURN, 0.0, typical=0.0)
    stiffness_n_per_m: float = parameter("N/m", 10.0, 1e5, 500.0, typical=500.0, log=True)
    elevation_rad: float = 0.0

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return walls all round, near and far: one that the tip does not reach has no slope to follow."""
        turns = np.linspace(-math.pi, math.pi, 6, endpoint=False)
        return [{"azimuth_rad": float(turn), "distance": far} for turn in turns for far in (0.02, 0.1, 0.25)]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (normal (3,), distance m, stiffness N/m)."""
        flat = math.cos(self.elevation_rad)
        normal = [
            flat * math.cos(self.azimuth_rad),
            flat * math.sin(self.azimuth_rad),
            math.sin(self.elevation_rad),
        ]
        reach = self.distance * robot.length_m if self.distance < 2.0 else math.inf
        return np.array([*normal, reach, self.stiffness_n_per_m])
