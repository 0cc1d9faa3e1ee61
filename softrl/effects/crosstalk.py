"""Chambers that feel each other's pressure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter


@standing_as(SIGNAL_KERNEL)
def crosstalk_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Add a share of the other chambers' pressures."""
    total = 0.0
    for i in range(len(value)):
        total += value[i]
    chamber = int(parameters[1])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] += parameters[0] * (total - value[i])


@dataclass(frozen=True)
class Crosstalk(Effect):
    """Acting pressure ``p_i + share * (sum of the others)``; ``chamber`` is the one that feels the others.

    A robot with one chamber has none.

    Notes
    -----
    Linear fluidic coupling in its static limit (no equation number checked).
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "cross-talk between chambers"
    kernel: ClassVar = crosstalk_kernel
    gauged: ClassVar[bool] = True

    share: float = parameter("1", -0.4, 0.4, 0.0, typical=0.1)
    chamber: int = -1
