"""A wall whose resistance levels off as it stretches, as rubber does before it stiffens."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import REST, STRAIN, multiply_wall
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def strain_softening_kernel(
    parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool
) -> None:
    """Scale the elastic resistance by ``residual + (1 - residual) / sqrt(1 + (stiffness e / level)^2)``."""
    fading, chamber = 1.0 - parameters[1], int(parameters[2])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            curvature = parameters[0] * port[REST, i]
            bent = curvature * port[STRAIN, i]
            kept = 1.0 / math.sqrt(1.0 + bent * bent)
            less = fading * (kept - 1.0)
            multiply_wall(port, chamber, i, less, -fading * kept * kept * kept * curvature * bent)


@dataclass(frozen=True)
class StrainSoftening(Effect):
    """Resistance over the model's ``residual + (1 - residual) / sqrt(1 + (s e)^2)``: linear at first, then nearly level.

    With ``s`` the model's stiffness at rest over the pressure at which the wall gives way, which is the robot's largest
    over ``softness``. Beyond it the slope is ``residual`` times the model's.

    Notes
    -----
    An empirical form (no equation number checked). A pressure and no strain says where the wall gives way, because
    that is what recordings show, however stiff it was before. Static, odd in strain, without memory; it never turns into
    a falling branch, so a body does not snap.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "strain softening of the wall"
    kernel: ClassVar = strain_softening_kernel

    softness: float = parameter("1", 0.0, 20.0, 0.0, typical=1.0)
    residual: float = parameter("1", 0.0, 1.0, 0.0, typical=0.03, default=0.0)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (softness 1/Pa, residual, chamber)."""
        return super().pack(robot) / [robot.largest_pa, 1.0, 1.0]
