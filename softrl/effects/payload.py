"""A mass at the tip."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import FORCE, FORCE_SLOPE, GRAVITY, TIP_VELOCITY
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def payload_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Add weight and inertia of the mass; the state is the tip's velocity at the last step."""
    mass = parameters[0]
    for k in range(3):
        acceleration = (port[TIP_VELOCITY, k] - state[k]) / dt
        port[FORCE, k] += mass * (port[GRAVITY, k] - acceleration)
        port[FORCE_SLOPE + k, k] -= mass / (dt * dt)
        if commit:
            state[k] = port[TIP_VELOCITY, k]


@dataclass(frozen=True)
class Payload(Effect):
    """Point mass at the tip, as a share of the robot's mass: weight along gravity, and inertia.

    Notes
    -----
    ``F = m (g - a)`` with the acceleration of the tip over the step (Newton, no equation number checked).
    """

    site: ClassVar[str] = "load"
    title: ClassVar[str] = "payload at the tip"
    kernel: ClassVar = payload_kernel
    exact: ClassVar[bool] = True

    mass: float = parameter("1", 0.0, 3.0, 0.0, typical=0.2, of="mass")

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (mass kg,)."""
        return np.array([self.mass * robot.mass_kg])

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the tip's velocity, m/s."""
        return np.zeros(3)
