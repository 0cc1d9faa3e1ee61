"""A chamber that acts more, or less, than its pressure says."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter


@standing_as(SIGNAL_KERNEL)
def gain_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Scale the acting pressure."""
    chamber = int(parameters[1])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] *= parameters[0]


@dataclass(frozen=True)
class Gain(Effect):
    """Acting pressure as a multiple of the supplied one: an effective area, or a regulator's span.

    Notes
    -----
    ``p_acting = gain p`` (no equation number checked).
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "gain of a chamber"
    kernel: ClassVar = gain_kernel
    of_area: ClassVar[bool] = True
    gauged: ClassVar[bool] = True
    exact: ClassVar[bool] = True

    gain: float = parameter("1", 0.1, 3.0, 1.0, typical=0.8)
    chamber: int = -1
