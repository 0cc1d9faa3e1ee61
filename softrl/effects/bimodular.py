"""A wall that resists being stretched more, or less, than being shortened."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import ADDED, ADDED_SLOPE, REST, STRAIN


@standing_as(PORT_KERNEL)
def bimodular_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Add to each wall's stiffness in stretch what is taken from it in compression."""
    contrast, width, chamber = parameters[0], parameters[1], int(parameters[2])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            stiff, reach = contrast * port[REST, i], math.hypot(port[STRAIN, i], width)
            port[ADDED, i] += stiff * (reach - width)
            port[ADDED_SLOPE, i] += stiff * port[STRAIN, i] / reach


@dataclass(frozen=True)
class Bimodular(Effect):
    """Stiffness ``1 + contrast`` times the wall's in stretch, ``1 - contrast`` times in compression, over ``width`` between.

    ``added = contrast * stiffness at rest * (sqrt(e^2 + width^2) - width)``: static, even, without memory. Folds that touch,
    fibres that go slack and struts that straighten do so.

    Notes
    -----
    Two moduli (Ambartsumyan's bimodular material, no equation number checked), rounded. Of strains far below the width only
    ``contrast / (2 width)`` shows, which is the first even term of any wall's expansion.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "a wall that resists stretching otherwise than shortening"
    kernel: ClassVar = bimodular_kernel

    contrast: float = parameter("1", -0.8, 0.8, 0.0, typical=0.3)
    width: float = parameter("1", 0.01, 1.0, 0.1, typical=0.1, log=True, default=0.1)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return a wall that is softer in stretch: far from 0 the motion is no straight line of the contrast."""
        return [{"contrast": -0.3}]
