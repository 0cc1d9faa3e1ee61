"""A wall that resists differently on the way out and back, however slowly it goes."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import ADDED, ADDED_SLOPE, RATE
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def hysteresis_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance the hysteretic share z in [-1, 1] exactly along the strain increment of the step."""
    height, yield_strain, chamber = parameters[0], parameters[1], int(parameters[2])
    for i in range(port.shape[1]):
        if chamber >= 0 and chamber != i:
            continue
        way = abs(port[RATE, i]) * dt / yield_strain
        direction = 1.0 if port[RATE, i] >= 0.0 else -1.0
        z = direction * state[i]  # seen along the motion: it grows towards 1
        if z < 0.0:  # unloading: straight until it is spent
            straight = min(way, -z)
            z, way = z + straight, way - straight
        slope = 1.0
        if z >= 0.0:
            z = 1.0 - (1.0 - z) * math.exp(-way)
            slope = 1.0 - z
        port[ADDED, i] += height * direction * z
        port[ADDED_SLOPE, i] += height * slope / yield_strain
        if commit:
            state[i] = direction * z


@dataclass(frozen=True)
class Hysteresis(Effect):
    """Bouc-Wen hysteresis of exponent 1: ``added = height * z`` with z driven by strain, not by time.

    ``height`` is a share of the robot's largest pressure; after a reversal ``yield_strain`` of motion spends
    it.

    Notes
    -----
    Bouc-Wen with n = 1 and beta = gamma = 1/2 (textbook form, no equation number checked):
    ``dz/de = (1 - |z|) / yield_strain`` while loading and ``1 / yield_strain`` while unloading. Both have
    closed forms, so the result does not depend on the step as long as the strain does not turn within it.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "rate-independent hysteresis of the wall"
    kernel: ClassVar = hysteresis_kernel
    sticks: ClassVar[bool] = True

    height: float = parameter("1", 0.0, 1.0, 0.0, typical=0.1)
    yield_strain: float = parameter("1", 0.001, 0.3, 0.02, typical=0.02, log=True)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (height Pa, yield strain, chamber)."""
        return super().pack(robot) * [robot.largest_pa, 1.0, 1.0]
