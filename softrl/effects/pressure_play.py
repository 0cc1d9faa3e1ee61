"""A chamber whose pressure acts with play: a bladder that sticks to its sleeve, a braid whose threads rub."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.play import ELEMENTS, spread_of
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def pressure_play_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let a share of each pressure follow it with play; the state is what follows, of every element."""
    share, half_width, spread, chamber = parameters[0], parameters[1], parameters[2], int(parameters[3])
    n = len(value)
    count = ELEMENTS if spread > 0.0 else 1
    for i in range(n):
        if chamber < 0 or chamber == i:
            total = 0.0
            for k in range(count):
                wide = half_width * spread_of(spread, k, count)
                follows = min(max(state[k * n + i], value[i] - wide), value[i] + wide)
                state[k * n + i] = follows
                total += follows
            value[i] += share * (total / count - value[i])


@dataclass(frozen=True)
class PressurePlay(Effect):
    """Acting pressure ``(1 - share) p + share P(p)``, ``P`` following the pressure with play of ``half_width`` either way.

    ``half_width`` is a share of the robot's largest pressure. ``P`` is the mean of five plays whose half-widths are
    ``1 - 0.8 spread`` to ``1 + 0.8 spread`` times it: at 0 all are alike and loops have one corner a side, at 1 five.

    Notes
    -----
    Sum of play operators of Prandtl and Ishlinskii, a Preisach model whose relays are as many at all pressures (textbook form, no
    equation number checked). It remembers pressures; a wall's ``play`` and ``hysteresis`` remember strains, which neighbouring
    chambers change, too: in a robot of one chamber they are alike. Exact for any step in which the pressure does not turn.
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "play between a chamber's pressure and what acts of it"
    kernel: ClassVar = pressure_play_kernel
    of_area: ClassVar[bool] = True
    sticks: ClassVar[bool] = True

    share: float = parameter("1", 0.0, 1.0, 0.0, typical=0.3)
    half_width: float = parameter("1", 0.005, 0.5, 0.1, typical=0.1, of="pressure", log=True)
    spread: float = parameter("1", 0.0, 1.0, 0.0, typical=0.5, default=0.0)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (share, half-width Pa, spread, chamber)."""
        return super().pack(robot) * [1.0, robot.largest_pa, 1.0, 1.0]

    def reset(self, robot: Robot) -> np.ndarray:
        """Return what follows the pressure without having moved yet, of every element."""
        return np.zeros(ELEMENTS * robot.chambers)
