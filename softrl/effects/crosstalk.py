"""Chambers that feel each other's pressure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import borrowing, standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@borrowing
def _weight(lean: float, by: int, count: int) -> float:
    """Return how much the chamber ``by`` places further round counts among ``count``: the next, the one before, any other."""
    if count == 2:
        return 1.0
    return 1.0 + lean if by == 1 else 1.0 - lean if by == count - 1 else 1.0 - abs(lean)


@standing_as(SIGNAL_KERNEL)
def crosstalk_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Add a share of the other chambers' pressures; the state is room for them as they were."""
    share, chamber = parameters[0], int(parameters[2])
    lean = parameters[1] if chamber >= 0 else 0.0
    n = len(value)
    for i in range(n):
        state[i] = value[i]
    for i in range(n):
        if chamber < 0 or chamber == i:
            for by in range(1, n):
                value[i] += share * _weight(lean, by, n) * state[(i + by) % n]


@dataclass(frozen=True)
class Crosstalk(Effect):
    """Acting pressure ``p_i + share * (sum of the others)``; ``chamber`` is the one that feels the others.

    One chamber may feel its neighbours unlike: the next, in the robot's order, counts ``1 + lean`` times, the one before
    ``1 - lean`` and those beyond ``1 - |lean|`` times, so that at 1 or -1 it feels one of them alone. Where all feel the others
    nothing leans. A robot with one chamber has none, with two no side.

    Notes
    -----
    Linear fluidic coupling in its static limit (no equation number checked).
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "cross-talk between chambers"
    kernel: ClassVar = crosstalk_kernel
    gauged: ClassVar[bool] = True

    share: float = parameter("1", -0.4, 0.4, 0.0, typical=0.1)
    lean: float = parameter("1", -1.0, 1.0, 0.0, typical=0.5, default=0.0)
    chamber: int = -1

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether there are others to feel."""
        return robot.chambers > 1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return a lean to the other side."""
        return [{"lean": -0.5}]
