"""A wall that resists more than in proportion as it stretches."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import ADDED, ADDED_SLOPE, REST, STRAIN

REFERENCE_STRAIN = 0.1


@standing_as(PORT_KERNEL)
def strain_stiffening_kernel(
    parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool
) -> None:
    """Add a spring along each chamber's elongation that is stiffer by a power of it."""
    growth, power, chamber = parameters[0], parameters[1], int(parameters[2])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            stiffer = growth * port[REST, i] * (abs(port[STRAIN, i]) / REFERENCE_STRAIN) ** power
            port[ADDED, i] += stiffer * port[STRAIN, i]
            port[ADDED_SLOPE, i] += (1.0 + power) * stiffer


@dataclass(frozen=True)
class StrainStiffening(Effect):
    """Stiffening by a power of strain, ``added = growth * stiffness at rest * e (|e| / 0.1)^power``: static, odd, without memory.

    ``growth = 1`` doubles the resistance at 10 % elongation.

    Notes
    -----
    At a power of 2 the first odd term beyond the linear one of an expansion, a cubic spring (no equation number checked); fabric
    and fibres that are drawn straight stiffen later and more steeply.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "strain stiffening of the wall"
    kernel: ClassVar = strain_stiffening_kernel

    growth: float = parameter("1", 0.0, 50.0, 0.0, typical=0.3)
    power: float = parameter("1", 0.5, 6.0, 2.0, typical=2.0, log=True, default=2.0)
    chamber: int = -1
