"""A chamber whose pressure pushes on less, or more, as it stretches."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import ADDED, ADDED_SLOPE, PRESSURE, STRAIN


@standing_as(PORT_KERNEL)
def stretch_area_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Take from each pressure what the area on which it acts has lost by stretching."""
    slope, chamber = parameters[0], int(parameters[1])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            port[ADDED, i] -= slope * port[PRESSURE, i] * port[STRAIN, i]
            port[ADDED_SLOPE, i] -= slope * port[PRESSURE, i]


@dataclass(frozen=True)
class StretchArea(Effect):
    """Effective area ``A (1 + slope e)`` of a chamber that has elongated by ``e``: static, without memory.

    Below zero pressure stiffens the body, as it does folded bellows that flatten; above zero it softens it.

    Notes
    -----
    The force of a chamber at one pressure is the change of its volume with its length (virtual work); this is its first term in
    the strain, where McKibben muscles have a quadratic one (Chou and Hannaford 1996; no equation number checked). The work of
    the pressure, ``p A L (e + slope e^2 / 2)``, is given back.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "effective area that changes as a chamber stretches"
    kernel: ClassVar = stretch_area_kernel

    slope: float = parameter("1", -15.0, 15.0, 0.0, typical=-2.0)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return an area that grows as well: far from 0 the motion is no straight line of the slope."""
        return [{"slope": 2.0}]
