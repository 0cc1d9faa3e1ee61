"""A base that leans over before a camera that stays where it is."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.effects.effect import Effect, parameter
from softrl.effects.frame import Frame
from softrl.effects.mount_tilt import MountTilt, mount_tilt_kernel
from softrl.robots.robot import Robot


@dataclass(frozen=True)
class BaseTilt(Effect):
    """Base turned by ``R`` before a standing camera: it sees ``R p_base`` of a body that feels ``R^T g``.

    Where weight does little, no motion tells it from a frame that is turned about the same axes, which is then meant.

    Notes
    -----
    ``R = (R_y R_x)^T`` about the base's origin, angles as in ``mount_tilt`` (rigid-body kinematics, no equation number
    checked).
    """

    site: ClassVar[str] = "load"
    title: ClassVar[str] = "tilt of the base before a camera that stands still"
    kernel: ClassVar = mount_tilt_kernel
    exact: ClassVar[bool] = True
    sudden: ClassVar[bool] = False
    extends: ClassVar[str] = "frame"

    about_x_rad: float = parameter("rad", -0.6, 0.6, 0.0, typical=0.15)
    about_y_rad: float = parameter("rad", -0.6, 0.6, 0.0, typical=0.15)

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether the robot reports where its tip is: a bend angle is measured from the base."""
        return robot.output != "bend_angle"

    def parts(self) -> tuple[Effect, ...]:
        """Return the tilt that the body feels and the turn that the camera sees."""
        seen = Rotation.from_euler("xy", [self.about_x_rad, self.about_y_rad]).inv().as_rotvec()
        when: dict[str, Any] = {"since_s": self.since_s, "over_s": self.over_s, "begun_s": self.begun_s}
        felt = MountTilt(self.about_x_rad, self.about_y_rad, **when)
        turned = Frame(seen[0], seen[1], seen[2], 0.0, 0.0, 0.0, **when)
        return felt, turned

    def pack(self, robot: Robot) -> np.ndarray:
        """Return the two angles."""
        return np.array([self.about_x_rad, self.about_y_rad])
