"""One pump for all chambers: what they draw together is limited."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.way import bound_of, mean_of_ramp
from softrl.robots.robot import Robot

UNLIMITED_PER_S = 1e4


@standing_as(SIGNAL_KERNEL)
def shared_flow_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let all pressures rise by no more than the pump's rate together, each by its share; they fall at once."""
    wanted, most = 0.0, bound_of(parameters[0], dt)
    for i in range(len(value)):
        wanted += max(value[i] - state[i], 0.0)
    share = min(most / wanted, 1.0) if wanted > 0.0 else 1.0
    for i in range(len(value)):
        lacks = value[i] - state[i]
        if lacks > 0.0:
            value[i] = mean_of_ramp(state[i], share * lacks, most * lacks / wanted)
            state[i] += share * lacks
        else:
            state[i] = value[i]


@dataclass(frozen=True)
class SharedFlow(Effect):
    """Bound on the sum of all chambers' rises, in the robot's largest pressure per second; at 1e4 there is none.

    Notes
    -----
    ``sum_i max(dp_i/dt, 0) <= rise``, shared out in proportion to what each chamber still lacks: a source of constant flow
    behind open valves fills chambers of equal volume so, one alone as fast as all others wait (textbook, no equation number
    checked). With one chamber driven at a time it is a limited rate of that chamber's.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "limited flow of the source that all chambers share"
    kernel: ClassVar = shared_flow_kernel
    flows: ClassVar[bool] = True

    rise_per_s: float = parameter("1/s", 0.02, UNLIMITED_PER_S, UNLIMITED_PER_S, typical=0.6, log=True, of="pressure")

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether there is anything to share."""
        return robot.chambers > 1 and robot.command == "pressure"

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return larger pumps: from one that is far too small no slope leads there."""
        return [{"rise_per_s": rate} for rate in (1.5, 5.0, 15.0)]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (rise Pa/s, chamber)."""
        rise, chamber = super().pack(robot)
        return np.array([rise * robot.largest_pa if rise < UNLIMITED_PER_S else np.inf, chamber])
