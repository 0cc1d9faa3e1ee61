"""A sensor whose base frame is not the robot's."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, TURN, Effect, parameter
from softrl.effects.quaternion import product
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def frame_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Turn the pose by the packed matrix and quaternion, then shift the position."""
    x, y, z = value[0], value[1], value[2]
    for k in range(3):
        value[k] = parameters[3 * k] * x + parameters[3 * k + 1] * y + parameters[3 * k + 2] * z + parameters[13 + k]
    a, b, c, d = parameters[9], parameters[10], parameters[11], parameters[12]
    value[3], value[4], value[5], value[6] = product(a, b, c, d, value[3:])


@dataclass(frozen=True)
class Frame(Effect):
    """Rotation (as a vector) and shift (in lengths of the robot) of the frame in which the sensor reports.

    Notes
    -----
    ``p = R p_base + shift`` with ``R`` from the rotation vector (textbook form, no equation number checked).
    Of a bend angle in a plane only the turn in that plane counts, which is a wrong zero. Any other would stretch angles one by
    one: a camera that looks aslant does, but so does a wall that gives way, which was taken for one.
    """

    site: ClassVar[str] = "sensor"
    title: ClassVar[str] = "misregistration of the sensor's frame"
    kernel: ClassVar = frame_kernel
    exact: ClassVar[bool] = True

    turn_x_rad: float = parameter("rad", -0.8, 0.8, 0.0, typical=0.1)
    turn_y_rad: float = parameter("rad", -0.8, 0.8, 0.0, typical=0.1)
    turn_z_rad: float = parameter("rad", -TURN, TURN, 0.0, typical=0.2)
    shift_x: float = parameter("1", -0.8, 0.8, 0.0, typical=0.02, of="length")
    shift_y: float = parameter("1", -0.8, 0.8, 0.0, typical=0.02, of="length")
    shift_z: float = parameter("1", -0.8, 0.8, 0.0, typical=0.02, of="length")

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (matrix (9,), quaternion (4,) w x y z, shift (3,) m)."""
        by = np.array([self.turn_x_rad, self.turn_y_rad, self.turn_z_rad])
        if robot.output == "bend_angle" and robot.bends_in_a_plane:
            x, y = robot.chamber_direction[0]
            normal = np.array([-y, x, 0.0])
            by = normal * (normal @ by)
        turn = Rotation.from_rotvec(by)
        shift = robot.length_m * np.array([self.shift_x, self.shift_y, self.shift_z])
        return np.concatenate([turn.as_matrix().ravel(), turn.as_quat(scalar_first=True), shift])
