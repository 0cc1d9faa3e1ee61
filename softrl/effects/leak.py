"""Air that escapes from a chamber faster than the source replaces it."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter


@nb.njit(SIGNAL_KERNEL, cache=True)
def leak_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Advance the deficit ``dd/dt = leak (p_supply - d) - d / refill`` exactly with the supply held."""
    leak, refill, chamber = parameters[0], parameters[1], int(parameters[2])
    rate = leak + 1.0 / refill
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            state[i] += -math.expm1(-rate * dt) * (leak * value[i] / rate - state[i])
            value[i] -= state[i]


@dataclass(frozen=True)
class Leak(Effect):
    """Leak against a refilling source: the chamber lacks ``d``, with ``dd/dt = leak (p - d) - d / refill``.

    Notes
    -----
    Linear leak (no equation number checked). With slow refill the chamber decays as ``exp(-leak t)`` after
    each fill; in the long run it settles at ``1 / (1 + leak refill)`` of the supply. Air in a sealed chamber
    is the limit of a long refill time.
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "leak of a chamber"
    kernel: ClassVar = leak_kernel
    stores: ClassVar[bool] = True

    leak_per_s: float = parameter("1/s", 0.0, 2.0, 0.0, typical=0.3)
    refill_s: float = parameter("s", 0.1, 1000.0, 10.0, typical=3.0, log=True)
    chamber: int = -1
