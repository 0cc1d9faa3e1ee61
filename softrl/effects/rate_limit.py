"""A supply that fills and vents no faster than its flow allows."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot

UNLIMITED_PER_S = 1e4


@standing_as(SIGNAL_KERNEL)
def rate_limit_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let the supplied pressure follow the command at no more than the two rates."""
    chamber = int(parameters[2])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            state[i] += min(max(value[i] - state[i], -parameters[1] * dt), parameters[0] * dt)
            value[i] = state[i]


@dataclass(frozen=True)
class RateLimit(Effect):
    """Bound on the supply's change, in the robot's largest pressure per second; at 1e4 there is none.

    Notes
    -----
    ``-fall <= dp/dt <= rise``. A source of constant flow fills a chamber of constant volume at a constant rate (no
    equation number checked).
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "limited rate of pressure change"
    kernel: ClassVar = rate_limit_kernel
    piped: ClassVar[bool] = True

    rise_per_s: float = parameter("1/s", 0.02, UNLIMITED_PER_S, UNLIMITED_PER_S, typical=0.4, log=True, of="pressure")
    fall_per_s: float = parameter("1/s", 0.02, UNLIMITED_PER_S, UNLIMITED_PER_S, typical=0.4, log=True, of="pressure")
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return faster valves: from one that is far too slow no slope leads there."""
        return [{"rise_per_s": rate, "fall_per_s": rate} for rate in (1.0, 3.0, 9.0)]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (rise Pa/s, fall Pa/s, chamber)."""
        rise, fall, chamber = super().pack(robot)
        rates = [rate * robot.pressure_max_pa if rate < UNLIMITED_PER_S else np.inf for rate in (rise, fall)]
        return np.array([*rates, chamber])
