"""A hose or cable that pulls at the tip."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import FORCE, FORCE_SLOPE, TIP
from softrl.robots.robot import Robot

AROUND = 4  # directions in which a search for the anchor begins
FAR = 0.2  # lengths of the robot from the tip at rest where it begins


@standing_as(PORT_KERNEL)
def tether_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Pull the tip towards the anchor, as far as it is farther away than the length that hangs free."""
    stiffness, free = parameters[0], parameters[4]
    square = 0.0
    for k in range(3):
        square += (port[TIP, k] - parameters[1 + k]) ** 2
    distance = math.sqrt(square)
    if distance <= free:
        return
    taut = 1.0 - free / distance if free > 0.0 else 1.0
    for k in range(3):
        away = port[TIP, k] - parameters[1 + k]
        along = away * away / square if free > 0.0 else 1.0
        port[FORCE, k] -= stiffness * taut * away
        port[FORCE_SLOPE + k, k] -= stiffness * (taut + (1.0 - taut) * along)


@dataclass(frozen=True)
class Tether(Effect):
    """Pull to a point beside the tip at rest, of a hose that is slack nearer than its free length; lengths of the robot.

    Notes
    -----
    Linear spring ``F = -k (d - d0) / d (tip - anchor)`` beyond the free length ``d0``, nothing within it (no equation
    number checked); without free length a plain spring.
    """

    site: ClassVar[str] = "load"
    title: ClassVar[str] = "pull of a hose or cable at the tip"
    kernel: ClassVar = tether_kernel

    stiffness_n_per_m: float = parameter("N/m", 0.0, 500.0, 0.0, typical=30.0)
    offset_x: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1, of="length")
    offset_y: float = parameter("1", -0.5, 0.5, 0.0, typical=0.0, of="length")
    free_length: float = parameter("1", 0.0, 0.5, 0.0, typical=0.05, default=0.0, of="length")

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return anchors all round: without a pull they have no slope to follow."""
        turns = 2.0 * math.pi * np.arange(AROUND) / AROUND
        return [{"offset_x": FAR * math.cos(turn), "offset_y": FAR * math.sin(turn)} for turn in turns]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (stiffness N/m, anchor (3,) m, free length m)."""
        anchor = robot.length_m * np.array([self.offset_x, self.offset_y, 1.0])
        return np.array([self.stiffness_n_per_m, *anchor, robot.length_m * self.free_length])
