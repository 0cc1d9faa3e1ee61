"""A base that is not mounted as the model assumes."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import GRAVITY
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def mount_tilt_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Turn gravity in the base frame about x, then about y."""
    cx, sx, cy, sy = (
        math.cos(parameters[0]),
        math.sin(parameters[0]),
        math.cos(parameters[1]),
        math.sin(parameters[1]),
    )
    gx, gy, gz = port[GRAVITY, 0], port[GRAVITY, 1], port[GRAVITY, 2]
    gy, gz = cx * gy - sx * gz, sx * gy + cx * gz
    port[GRAVITY, 0], port[GRAVITY, 1], port[GRAVITY, 2] = cy * gx + sy * gz, gy, -sy * gx + cy * gz


@dataclass(frozen=True)
class MountTilt(Effect):
    """Gravity turned in the base frame about x, then y: the mount is tilted, its sensor's frame with it.

    Its name stands before ``payload`` so that a payload's weight is tilted too.

    Notes
    -----
    ``g = R_y R_x g_nominal`` (rigid-body kinematics, no equation number checked).
    """

    site: ClassVar[str] = "load"
    title: ClassVar[str] = "tilt of the mount against gravity"
    kernel: ClassVar = mount_tilt_kernel
    exact: ClassVar[bool] = True
    sudden: ClassVar[bool] = False

    about_x_rad: float = parameter("rad", -0.6, 0.6, 0.0, typical=0.15)
    about_y_rad: float = parameter("rad", -0.6, 0.6, 0.0, typical=0.15)

    def pack(self, robot: Robot) -> np.ndarray:
        """Return the two angles."""
        return np.array([self.about_x_rad, self.about_y_rad])
