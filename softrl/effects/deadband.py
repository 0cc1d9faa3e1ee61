"""A regulator that rests while its error is small."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.way import bound_of, mean_of_ramp
from softrl.robots.robot import Robot

AT_ONCE_PER_S = 1e4  # faster filling takes no time


@standing_as(SIGNAL_KERNEL)
def deadband_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Open valves beyond the band, fill towards the command, close them again; the state is supply and open, per chamber."""
    band, closes, chamber, count = parameters[0], parameters[1] * parameters[0], int(parameters[3]), len(value)
    most = bound_of(parameters[2], dt)
    for i in range(count):
        if chamber < 0 or chamber == i:
            gap = value[i] - state[i]
            if abs(gap) > band:
                state[count + i] = 1.0
            value[i] = state[i]
            if state[count + i] > 0.0:
                left = abs(gap) - most
                if left <= closes:
                    left, state[count + i] = min(closes, abs(gap)), 0.0
                moved = gap - math.copysign(left, gap)
                value[i] = mean_of_ramp(state[i], moved, most)
                state[i] += moved


@dataclass(frozen=True)
class Deadband(Effect):
    """Valves that stay shut while ``|p - p_cmd| <= band``, a share of the robot's largest pressure.

    Notes
    -----
    A regulator that switches with a differential gap: its valves open where the error leaves the band and close where it is
    back at ``closes_at`` of it; in between the flow is that of a choked opening into a constant volume, so that the pressure
    moves at ``fill_per_s`` of the robot's largest pressure (textbook relay and choked flow, no equation number checked). With
    ``closes_at`` 1 and no time to fill the supply follows at the band's edge, which is play.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "deadband of the pressure regulator"
    kernel: ClassVar = deadband_kernel
    flows: ClassVar[bool] = True
    sticks: ClassVar[bool] = True
    extends: ClassVar[str] = "rate_limit"  # without a band the flow is limited, and nothing else
    essence: ClassVar[tuple[str, ...]] = ("band",)

    band: float = parameter("1", 0.0, 0.3, 0.0, typical=0.05, of="pressure")
    closes_at: float = parameter("1", 0.0, 1.0, 1.0, typical=1.0, scale=0.5, default=1.0)
    fill_per_s: float = parameter(
        "1/s", 0.5, AT_ONCE_PER_S, AT_ONCE_PER_S, typical=AT_ONCE_PER_S, log=True, default=AT_ONCE_PER_S
    )
    chamber: int = -1

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether pressures are commanded: a pump's duty cycle has no error to regulate."""
        return robot.command == "pressure"

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return bands that close at different places: a staircase has its steps elsewhere for every one."""
        return [
            {"band": band, "closes_at": at, "fill_per_s": fill}
            for band in (0.02, 0.04, 0.08, 0.15)
            for at in (0.0, 0.5)
            for fill in (AT_ONCE_PER_S, 3.0)
        ]

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the supplied pressures and which valves are open."""
        return np.zeros(2 * robot.chambers)

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (band Pa, share of it at which valves close, rate of filling Pa/s, chamber)."""
        band, closes_at, fill, chamber = super().pack(robot)
        fill_pa_per_s = fill * robot.largest_pa if fill < AT_ONCE_PER_S else np.inf
        return np.array([band * robot.largest_pa, closes_at, fill_pa_per_s, chamber])
