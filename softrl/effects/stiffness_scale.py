"""A wall that is stiffer, or softer, than the model's."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import multiply_body


@standing_as(PORT_KERNEL)
def stiffness_scale_kernel(
    parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool
) -> None:
    """Add ``scale - 1`` times the elastic resistance: the whole body's, or one chamber's own spring."""
    more, chamber = parameters[0] - 1.0, int(parameters[1])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            multiply_body(port, chamber, i, more)


@dataclass(frozen=True)
class StiffnessScale(Effect):
    """Stiffness as a multiple of the model's: of the whole body, or of one chamber (an asymmetry).

    Notes
    -----
    ``p_elastic = scale p_elastic`` (no equation number checked): for all chambers this scales the elastic forces
    exactly, from the rest under weight on, which stays. One chamber gets a linear spring along its own elongation,
    ``(scale - 1)`` times the stiffness of its wall, which keeps the body's stiffness symmetric: it stores energy and gives it
    back. The search goes along a straight axis from 1, not a logarithmic one: a few per cent are looked at as well as a factor.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "stiffness of the body or of one chamber"
    kernel: ClassVar = stiffness_scale_kernel
    retunes: ClassVar[bool] = True

    scale: float = parameter("1", 0.4, 5.0, 1.0, typical=1.4)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return walls that are plainly softer and plainly stiffer: far from 1 the motion is no straight line of the scale."""
        return [{"scale": 0.6}, {"scale": 3.0}]
