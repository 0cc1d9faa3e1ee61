"""Air that escapes from a chamber faster than the source replaces it."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot

SMALL = 0.01  # of the largest pressure: below it the flow through an orifice grows in proportion


@standing_as(SIGNAL_KERNEL)
def leak_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Advance the deficit ``dd/dt = leak |p / p_max|^(n - 1) p - d / refill`` of ``p = p_supply - d``, the supply held.

    Exactly for an exponent n of one, else with the flow per pressure of the step's beginning. What would be missing below the
    robot's lowest pressure, or the supply where that is lower, is not: it was let out.
    """
    refill, exponent, largest, lowest = parameters[1], parameters[2], parameters[3], parameters[4]
    chamber = int(parameters[5])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            leak = parameters[0]
            if exponent < 1.0:
                inside = (value[i] - state[i]) / largest
                leak *= (inside * inside + SMALL * SMALL) ** (0.5 * (exponent - 1.0))
            rate, begin = leak + 1.0 / refill, state[i]
            state[i] += -math.expm1(-rate * dt) * (leak * value[i] / rate - state[i])
            state[i] = min(state[i], value[i] - min(value[i], lowest))
            value[i] -= 0.5 * (min(begin, value[i] - min(value[i], lowest)) + state[i])


@dataclass(frozen=True)
class Leak(Effect):
    """Leak against a refilling source: the chamber lacks ``d``, ``dd/dt = leak (p - d) |(p - d) / p_max|^(n - 1) - d / refill``.

    Notes
    -----
    An ``exponent`` n of 1 is the laminar flow through a porous wall or a long crack, of 0.5 that through an orifice, which
    grows with the root of the pressure (no equation number checked). With n = 1 and slow refill the chamber decays as
    ``exp(-leak t)`` after each fill; in the long run it settles at ``1 / (1 + leak refill)`` of the supply. Air in a
    sealed chamber is the limit of a long refill time. Vented faster than it is refilled, a chamber is empty at the robot's
    smallest pressure, or 0 if that is above it, and ``d`` is what the supply still has above that.
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "leak of a chamber"
    kernel: ClassVar = leak_kernel
    flows: ClassVar[bool] = True
    gauged: ClassVar[bool] = True
    stores: ClassVar[bool] = True

    leak_per_s: float = parameter("1/s", 0.0, 2.0, 0.0, typical=0.3)
    refill_s: float = parameter("s", 0.1, 1000.0, 10.0, typical=3.0, log=True)
    exponent: float = parameter("1", 0.5, 1.0, 1.0, typical=1.0, scale=0.5, default=1.0)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (leak 1/s, refill s, exponent, largest and lowest pressure Pa, chamber)."""
        own = super().pack(robot)
        return np.array([*own[:3], robot.largest_pa, robot.lowest_pa, own[3]])
