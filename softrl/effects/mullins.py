"""A wall that has grown softer up to where it was stretched before."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import (
    ADDED,
    ADDED_SLOPE,
    ELASTIC,
    ELASTIC_SLOPE,
    PORT_KERNEL,
    STRAIN,
    Effect,
    parameter,
)


@nb.njit(PORT_KERNEL, cache=True)
def mullins_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Take away a share of the elastic resistance, growing with the distance below the largest strain."""
    softening, width, chamber = parameters[0], parameters[1], int(parameters[2])
    for i in range(port.shape[1]):
        if chamber >= 0 and chamber != i:
            continue
        strain = abs(port[STRAIN, i])
        largest = max(state[i], strain)
        kept = math.exp((strain - largest) / width)
        lost = softening * (1.0 - kept)
        port[ADDED, i] -= lost * port[ELASTIC, i]
        port[ADDED_SLOPE, i] -= lost * port[ELASTIC_SLOPE, i]
        if strain < largest:
            sign = 1.0 if port[STRAIN, i] >= 0.0 else -1.0
            port[ADDED_SLOPE, i] += sign * softening * kept / width * port[ELASTIC, i]
        if commit:
            state[i] = largest


@dataclass(frozen=True)
class Mullins(Effect):
    """Softening below the largest strain: ``1 - softening (1 - exp((|e| - e_max) / width))`` of the resistance.

    Notes
    -----
    After the idea of pseudo-elasticity, damage by distance from the running maximum, here in strain instead
    of energy (no equation number checked). On virgin loading it vanishes; it has no recovery.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "softening below the largest strain so far (Mullins)"
    kernel: ClassVar = mullins_kernel

    softening: float = parameter("1", 0.0, 0.8, 0.0, typical=0.3)
    width: float = parameter("1", 0.002, 0.5, 0.05, typical=0.03, log=True)
    chamber: int = -1
