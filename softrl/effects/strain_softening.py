"""A wall whose resistance levels off as it stretches, as rubber does before it stiffens."""

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
def strain_softening_kernel(
    parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool
) -> None:
    """Scale the elastic resistance by ``1 / sqrt(1 + (curvature e)^2)``."""
    chamber = int(parameters[1])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            bent = parameters[0] * port[STRAIN, i]
            kept = 1.0 / math.sqrt(1.0 + bent * bent)
            port[ADDED, i] += (kept - 1.0) * port[ELASTIC, i]
            port[ADDED_SLOPE, i] += (kept - 1.0) * port[ELASTIC_SLOPE, i]
            port[ADDED_SLOPE, i] -= kept * kept * kept * parameters[0] * bent * port[ELASTIC, i]


@dataclass(frozen=True)
class StrainSoftening(Effect):
    """Resistance over the model's ``1 / sqrt(1 + (curvature e)^2)``: linear at first, then level.

    Notes
    -----
    The level is the model's stiffness over ``curvature`` (an empirical form, no equation number checked).
    Static, odd in strain, without memory; it never turns into a falling branch, so a body does not snap.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "strain softening of the wall"
    kernel: ClassVar = strain_softening_kernel

    curvature: float = parameter("1", 0.0, 200.0, 0.0, typical=10.0)
    chamber: int = -1
