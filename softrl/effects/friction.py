"""Dry friction between layers of the wall, or against a sleeve."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import ADDED, ADDED_SLOPE, PORT_KERNEL, PRESSURE, RATE, Effect, parameter
from softrl.robots.robot import Robot

SLIP_RATE_PER_S = 1e-3  # strain rate at which friction has reached three quarters of its height


@standing_as(PORT_KERNEL)
def friction_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Add friction against the strain rate, smoothed about zero."""
    chamber = int(parameters[2])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            height = parameters[0] + parameters[1] * abs(port[PRESSURE, i])
            slip = math.tanh(port[RATE, i] / SLIP_RATE_PER_S)
            port[ADDED, i] += height * slip
            port[ADDED_SLOPE, i] += height * (1.0 - slip * slip) / (SLIP_RATE_PER_S * dt)


@dataclass(frozen=True)
class Friction(Effect):
    """Coulomb friction: a share of the robot's largest pressure plus a share of the acting pressure.

    Notes
    -----
    ``added = (dry + loaded |p|) tanh(rate / 1e-3 per s)`` (regularised Coulomb law, no equation number
    checked). Instead of sticking the wall creeps at well under 1e-3 per second.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "dry friction in the wall"
    kernel: ClassVar = friction_kernel
    sticks: ClassVar[bool] = True

    dry: float = parameter("1", 0.0, 0.5, 0.0, typical=0.05)
    loaded: float = parameter("1", 0.0, 0.5, 0.0, typical=0.05)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (dry Pa, loaded, chamber)."""
        return super().pack(robot) * [robot.largest_pa, 1.0, 1.0]
