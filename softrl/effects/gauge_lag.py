"""A gauge that follows the pressure slowly: at the end of a thin tube, or behind a filter."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.core.errors import ConfigError
from softrl.effects.effect import EVERYWHERE, SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def gauge_lag_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Advance ``dp_reported/dt = (p - p_reported) / time`` exactly over ``dt`` with the pressure held."""
    chamber = int(parameters[1])
    share = 1.0 if parameters[0] <= 0.0 else -math.expm1(-dt / parameters[0])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            state[i] += share * (value[i] - state[i])
            value[i] = state[i]


@dataclass(frozen=True)
class GaugeLag(Effect):
    """Reported chamber pressure of first order, ``dp_reported/dt = (p - p_reported) / time``.

    Notes
    -----
    Textbook first-order model of a pressure gauge behind a line or a filter (no equation number checked). The motion does not
    change under the same commands; in a replay that puts the measured pressure behind the valve, what acted was ahead of it.
    """

    site: ClassVar[str] = "sensor"
    channel: ClassVar[str] = "pressure"
    title: ClassVar[str] = "slow pressure gauge"
    kernel: ClassVar = gauge_lag_kernel

    time_s: float = parameter("s", 0.0, 2.0, 0.0, typical=0.1)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return what gauges report at rest, zero."""
        return np.zeros(robot.chambers)

    def undo(self, robot: Robot, reported: np.ndarray, share: np.ndarray, dt_s: float) -> np.ndarray:
        """Return the pressures (steps, chambers) Pa that the gauge followed where it ``reported`` these, ``dt_s`` apart.

        Raises
        ------
        ConfigError
            If it is slow above a pressure only: what it saw does not follow from what it reported.
        """
        if self.above_share > EVERYWHERE:
            raise ConfigError(
                f"effect gauge_lag.above_share={self.above_share:g}: measured pressures cannot drive a body behind a gauge "
                "that is slow above a pressure only; expected drive=command"
            )
        if self.time_s <= 0.0:
            return reported
        seen = np.array(reported, dtype=float)
        mine = slice(None) if self.chamber < 0 else slice(self.chamber, self.chamber + 1)
        followed = -math.expm1(-dt_s / self.time_s)
        seen[1:, mine] += share[1:] * (1.0 / followed - 1.0) * np.diff(reported[:, mine], axis=0)
        return seen
