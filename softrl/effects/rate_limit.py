"""A supply that fills and vents no faster than its flow allows."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.way import bound_of, mean_of_lag, mean_of_ramp, share_of_lag
from softrl.robots.robot import Robot

UNLIMITED_PER_S = 1e4


@standing_as(SIGNAL_KERNEL)
def rate_limit_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let the supplied pressure follow the command with its lag, at no more than the two rates."""
    lag_s, chamber = parameters[2], int(parameters[3])
    rise, fall, share = bound_of(parameters[0], dt), bound_of(parameters[1], dt), share_of_lag(lag_s, dt)
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            free = share * (value[i] - state[i])
            moved = min(max(free, -fall), rise)
            if lag_s > 0.0 and moved == free:
                value[i] = mean_of_lag(value[i], state[i], moved, lag_s, dt)
            else:
                value[i] = mean_of_ramp(state[i], moved, rise if moved > 0.0 else fall)
            state[i] += moved


@dataclass(frozen=True)
class RateLimit(Effect):
    """Bound on the supply's change, in the robot's largest pressure per second; at 1e4 there is none.

    Notes
    -----
    ``dp/dt = (p_cmd - p) / lag_s``, and ``-fall <= dp/dt <= rise``. A source of constant flow fills a chamber of constant
    volume at a constant rate; a regulator that opens in proportion to its error does so until little is left (textbook, no
    equation number checked). Without bounds it is a lag; without a lag the command is met at full rate.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "limited rate of pressure change"
    kernel: ClassVar = rate_limit_kernel
    flows: ClassVar[bool] = True
    piped: ClassVar[bool] = True
    contains: ClassVar[tuple[str, ...]] = ("lag",)
    essence: ClassVar[tuple[str, ...]] = ("rise_per_s", "fall_per_s")

    rise_per_s: float = parameter("1/s", 0.02, UNLIMITED_PER_S, UNLIMITED_PER_S, typical=0.4, log=True, of="pressure")
    fall_per_s: float = parameter("1/s", 0.02, UNLIMITED_PER_S, UNLIMITED_PER_S, typical=0.4, log=True, of="pressure")
    lag_s: float = parameter("s", 0.0, 2.0, 0.0, typical=0.05, default=0.0)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return faster valves: from one that is far too slow no slope leads there."""
        return [{"rise_per_s": rate, "fall_per_s": rate} for rate in (1.0, 3.0, 9.0)]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (rise Pa/s, fall Pa/s, lag s, chamber)."""
        rise, fall, lag_s, chamber = super().pack(robot)
        rates = [rate * robot.largest_pa if rate < UNLIMITED_PER_S else np.inf for rate in (rise, fall)]
        return np.array([*rates, lag_s, chamber])
