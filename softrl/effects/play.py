"""A wall with backlash: after a reversal it first gives way to no motion, then follows, however slowly it goes."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import ADDED, ADDED_SLOPE, PORT_KERNEL, RATE, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def play_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance a spring in series with a slider: straight up to the height, level beyond it."""
    height, yield_strain, chamber = parameters[0], parameters[1], int(parameters[2])
    for i in range(port.shape[1]):
        if chamber >= 0 and chamber != i:
            continue
        share = state[i] + port[RATE, i] * dt / yield_strain
        held = min(max(share, -1.0), 1.0)
        port[ADDED, i] += height * held
        if held == share:
            port[ADDED_SLOPE, i] += height / yield_strain
        if commit:
            state[i] = held


@dataclass(frozen=True)
class Play(Effect):
    """Play between pressure and strain: ``added = height * z``, ``z`` following the strain but never beyond 1.

    Around the elastic wall this is the play operator from pressure to strain of half-width ``height`` (a share of the
    robot's largest pressure); ``yield_strain`` is what the stuck wall still gives way by.

    Notes
    -----
    Stop operator of Prandtl, ``dz/de = 1 / yield_strain`` within ``|z| < 1`` (textbook form, no equation number
    checked); a sum of such elements is a Prandtl-Ishlinskii model, which this is not. Unlike Bouc-Wen it has corners,
    unlike the regularised friction it sticks for good. Exact for any step in which the strain does not turn.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "play (backlash) of the wall"
    kernel: ClassVar = play_kernel
    variant_of: ClassVar[str] = "hysteresis"
    sticks: ClassVar[bool] = True

    height: float = parameter("1", 0.0, 1.0, 0.0, typical=0.1)
    yield_strain: float = parameter("1", 0.0005, 0.3, 0.005, typical=0.005, log=True)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (height Pa, yield strain, chamber)."""
        return super().pack(robot) * [robot.pressure_max_pa, 1.0, 1.0]
