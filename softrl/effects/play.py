"""A wall with backlash: after a reversal it first gives way to no motion, then follows, however slowly it goes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import borrowing, standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import ADDED, ADDED_SLOPE, RATE
from softrl.robots.robot import Robot

ELEMENTS = 5


@borrowing
def spread_of(spread: float, k: int, count: int) -> float:
    """Return how far one of ``count`` elements yields over what they do on average."""
    return 1.0 + spread * ((2 * k + 1) / count - 1.0)


@standing_as(PORT_KERNEL)
def play_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance springs in series with sliders: each straight up to its height, level beyond it."""
    height, yield_strain, spread, chamber = parameters[0], parameters[1], parameters[2], int(parameters[3])
    n = port.shape[1]
    count = ELEMENTS if spread > 0.0 else 1
    slope = height / (yield_strain * count)
    for i in range(n):
        if chamber >= 0 and chamber != i:
            continue
        for k in range(count):
            yields = yield_strain * spread_of(spread, k, count)
            share = state[k * n + i] + port[RATE, i] * dt / yields
            held = min(max(share, -1.0), 1.0)
            port[ADDED, i] += slope * yields * held
            if held == share:
                port[ADDED_SLOPE, i] += slope
            if commit:
                state[k * n + i] = held


@dataclass(frozen=True)
class Play(Effect):
    """Play between pressure and strain: ``added = height * z``, ``z`` following the strain but never beyond 1.

    Around the elastic wall this is the play operator from pressure to strain of half-width ``height`` (a share of the
    robot's largest pressure); ``yield_strain`` is what the stuck wall still gives way by. With a ``spread`` it is the sum of five
    such elements of equal stiffness that yield at ``1 - 0.8 spread`` to ``1 + 0.8 spread`` times that strain: loops get rounder.

    Notes
    -----
    Stop operator of Prandtl, ``dz/de = 1 / yield_strain`` within ``|z| < 1``, and the sum of such elements of Prandtl, Ishlinskii
    and Iwan (textbook form, no equation number checked). Unlike Bouc-Wen one element has corners, unlike dry friction its
    height does not follow the pressure. Exact for any step in which the strain does not turn.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "play (backlash) of the wall"
    kernel: ClassVar = play_kernel
    variant_of: ClassVar[str] = "hysteresis"
    sticks: ClassVar[bool] = True

    height: float = parameter("1", 0.0, 1.0, 0.0, typical=0.1)
    yield_strain: float = parameter("1", 0.0005, 0.3, 0.005, typical=0.005, log=True)
    spread: float = parameter("1", 0.0, 1.0, 0.0, typical=0.5, default=0.0)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (height Pa, yield strain, spread, chamber)."""
        return super().pack(robot) * [robot.largest_pa, 1.0, 1.0, 1.0]

    def reset(self, robot: Robot) -> np.ndarray:
        """Return how far every element is drawn, of each chamber: not at all."""
        return np.zeros(ELEMENTS * robot.chambers)
