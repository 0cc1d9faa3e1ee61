"""A tube between valve and chamber that carries inertia and friction of its air."""

from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@nb.njit(SIGNAL_KERNEL, cache=True)
def tube_line_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Advance ``T^2 p'' + 2 zeta T p' + p = p_in`` by implicit Euler."""
    period, zeta, chamber = parameters[0], parameters[1], int(parameters[2])
    n = len(value)
    for i in range(n):
        if (chamber >= 0 and chamber != i) or period <= 0.0:
            continue
        a, b = (period / dt) ** 2, 2.0 * zeta * period / dt
        state[n + i] = (a * state[n + i] + value[i] - state[i]) / (a + b + 1.0)  # change of p over the step
        state[i] += state[n + i]
        value[i] = state[i]


@dataclass(frozen=True)
class TubeLine(Effect):
    """Second-order line, ``T^2 p'' + 2 zeta T p' + p = p_in``: a late, non-exponential rise, or ringing.

    Notes
    -----
    Lumped inertance, resistance and compliance of a line (no equation number checked). Long narrow tubes have
    a tail of fractional order, which this does not have.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "second-order dynamics of the tube"
    kernel: ClassVar = tube_line_kernel
    piped: ClassVar[bool] = True
    extends: ClassVar[str] = "lag"

    period_s: float = parameter("s", 0.0, 1.0, 0.0, typical=0.1)
    damping_ratio: float = parameter("1", 0.1, 3.0, 1.0, typical=0.4)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the pressures at the end of the line, then their change over the last step, all zero."""
        return np.zeros(2 * robot.chambers)
