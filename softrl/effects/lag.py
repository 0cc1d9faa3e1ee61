"""A regulator that follows its command with a first-order lag, slower when venting than when filling."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.way import mean_of_lag, share_of_lag
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def lag_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Advance ``dp/dt = (p_cmd - p) / tau`` exactly over ``dt`` with the command held, whose mean lack is ``tau dp / dt``."""
    chamber = int(parameters[2])
    for i in range(len(value)):
        if chamber >= 0 and chamber != i:
            continue
        tau = parameters[0] if value[i] >= state[i] else parameters[1]
        moved = (value[i] - state[i]) * share_of_lag(tau, dt)
        value[i] = mean_of_lag(value[i], state[i], moved, tau, dt)
        state[i] += moved


@dataclass(frozen=True)
class Lag(Effect):
    """First-order valve lag, ``dp/dt = (p_cmd - p) / tau`` with tau by the sign of the change.

    Notes
    -----
    Textbook first-order model of a pneumatic regulator (no equation number checked). A regulator's own limit on flow
    makes the venting constant longer than the filling one.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "first-order lag of the pressure"
    kernel: ClassVar = lag_kernel
    flows: ClassVar[bool] = True
    piped: ClassVar[bool] = True

    fill_s: float = parameter("s", 0.0, 5.0, 0.0, typical=0.3)
    vent_s: float = parameter("s", 0.0, 5.0, 0.0, typical=0.3)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the supplied pressures at rest, zero gauge."""
        return np.zeros(robot.chambers)
