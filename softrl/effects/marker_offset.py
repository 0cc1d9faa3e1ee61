"""A marker that sits beside the point whose motion is meant."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def marker_offset_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Add the offset, turned with the tip: ``p + R(q) o`` by ``o + 2 w (u x o) + 2 u x (u x o)``."""
    a, b, c = parameters[0], parameters[1], parameters[2]
    w, x, y, z = value[3], value[4], value[5], value[6]
    d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    value[0] += a + w * d + y * f - z * e
    value[1] += b + w * e + z * d - x * f
    value[2] += c + w * f + x * e - y * d


@dataclass(frozen=True)
class MarkerOffset(Effect):
    """Marker at an offset (in lengths of the robot) in the tip's frame: it turns with the tip.

    Notes
    -----
    ``p_marker = p + R(q) offset`` (rigid-body kinematics, no equation number checked).
    """

    site: ClassVar[str] = "sensor"
    title: ClassVar[str] = "offset of the marker from the tip"
    kernel: ClassVar = marker_offset_kernel
    exact: ClassVar[bool] = True

    x: float = parameter("1", -0.3, 0.3, 0.0, typical=0.03, of="length")
    y: float = parameter("1", -0.3, 0.3, 0.0, typical=0.03, of="length")
    z: float = parameter("1", -0.3, 0.3, 0.0, typical=0.03, of="length")

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether the robot reports where its tip is: a bend angle is the same beside it."""
        return robot.output != "bend_angle"

    def pack(self, robot: Robot) -> np.ndarray:
        """Return the offset (3,) m."""
        return robot.length_m * np.array([self.x, self.y, self.z])
