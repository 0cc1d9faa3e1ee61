"""A valve that is fully open either way: it fills at a constant rate and vents in proportion to the pressure."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.way import bound_of, mean_of_lag, mean_of_ramp, share_of_lag
from softrl.robots.robot import Robot

UNLIMITED_PER_S = 1e4


@standing_as(SIGNAL_KERNEL)
def flow_limit_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let the supplied pressure follow with its lag, rise at no more than its rate and fall no faster than to the lowest."""
    rise, vent_s, lag_s, lowest, chamber = parameters[0], parameters[1], parameters[2], parameters[3], int(parameters[4])
    share, vents, most = share_of_lag(lag_s, dt), share_of_lag(vent_s, dt), bound_of(rise, dt)
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            free = share * (value[i] - state[i])
            vented = -math.inf if vent_s <= 0.0 else -vents * max(state[i] - lowest, 0.0)
            moved = min(max(free, vented), most)
            if lag_s > 0.0 and moved == free:
                value[i] = mean_of_lag(value[i], state[i], moved, lag_s, dt)
            elif moved < free:
                value[i] = mean_of_ramp(state[i], moved, most)
            elif moved > free:
                value[i] = mean_of_lag(min(lowest, state[i]), state[i], moved, vent_s, dt)
            else:
                value[i] = mean_of_ramp(state[i], moved, most if moved > 0.0 else -vented)
            state[i] += moved


@dataclass(frozen=True)
class FlowLimit(Effect):
    """Filling at ``dp/dt = rise`` at most, venting at ``dp/dt = -(p - p_min) / tau`` at most, with a lag near the command.

    The rise is in the robot's largest pressure per second, at 1e4 there is no limit; ``p_min`` is the robot's smallest
    pressure, towards which it vents. ``lag_s`` is that of ``rate_limit``.

    Notes
    -----
    A source of much higher pressure is choked and fills a chamber of constant volume at a constant rate; the flow out
    grows with the pressure that drives it, so that venting is exponential, towards the outside and not towards the
    command (isothermal orifice flow, no equation number checked).
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "limited flow of the valve: constant rate of filling, venting in proportion to the pressure"
    kernel: ClassVar = flow_limit_kernel
    flows: ClassVar[bool] = True
    piped: ClassVar[bool] = True
    variant_of: ClassVar[str] = "rate_limit"
    contains: ClassVar[tuple[str, ...]] = ("lag",)
    essence: ClassVar[tuple[str, ...]] = ("rise_per_s", "vent_s")

    rise_per_s: float = parameter("1/s", 0.02, UNLIMITED_PER_S, UNLIMITED_PER_S, typical=0.4, log=True, of="pressure")
    vent_s: float = parameter("s", 0.0, 10.0, 0.0, typical=0.5)
    lag_s: float = parameter("s", 0.0, 2.0, 0.0, typical=0.05, default=0.0)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return faster valves: from one that is far too slow no slope leads there."""
        return [{"rise_per_s": rate, "vent_s": 1.0 / rate} for rate in (1.0, 3.0, 9.0)]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (rise Pa/s, time constant s, lag s, lowest pressure Pa, chamber)."""
        rise, vent_s, lag_s, chamber = super().pack(robot)
        rise_pa_per_s = rise * robot.largest_pa if rise < UNLIMITED_PER_S else np.inf
        return np.array([rise_pa_per_s, vent_s, lag_s, robot.lowest_pa, chamber])
