"""A wall that resists more than in proportion as it stretches."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import ADDED, ADDED_SLOPE, PORT_KERNEL, REST, STRAIN, Effect, parameter

REFERENCE_STRAIN = 0.1


@standing_as(PORT_KERNEL)
def strain_stiffening_kernel(
    parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool
) -> None:
    """Add a cubic spring along each chamber's elongation."""
    chamber = int(parameters[1])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            square = (port[STRAIN, i] / REFERENCE_STRAIN) ** 2
            port[ADDED, i] += parameters[0] * port[REST, i] * square * port[STRAIN, i]
            port[ADDED_SLOPE, i] += 3.0 * parameters[0] * port[REST, i] * square


@dataclass(frozen=True)
class StrainStiffening(Effect):
    """Cubic stiffening, ``added = cubic * stiffness at rest * e (e / 0.1)^2``: static, odd, without memory.

    ``cubic = 1`` doubles the resistance at 10 % elongation.

    Notes
    -----
    First odd term beyond the linear one of an expansion (no equation number checked).
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "strain stiffening of the wall"
    kernel: ClassVar = strain_stiffening_kernel

    cubic: float = parameter("1", 0.0, 50.0, 0.0, typical=2.0)
    chamber: int = -1
