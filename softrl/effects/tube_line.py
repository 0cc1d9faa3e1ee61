"""A tube between valve and chamber that carries inertia and friction of its air."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.free_motion import free_motion
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def tube_line_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Advance ``T^2 p'' + 2 zeta T p' + p = p_in`` exactly over ``dt`` with the input held; its mean is that of the equation."""
    unit_s, zeta, chamber = parameters[0], parameters[1], int(parameters[2])
    n = len(value)
    if unit_s <= 0.0:
        return
    decay, square = zeta / unit_s, (zeta * zeta - 1.0) / (unit_s * unit_s)
    even, odd = free_motion(decay, square, dt)
    for i in range(n):
        if chamber < 0 or chamber == i:
            if dt <= 0.0:
                value[i] = state[i]
                continue
            begin, apart, rate = state[i], state[i] - value[i], state[n + i]
            state[i] = value[i] + (even + decay * odd) * apart + odd * rate
            state[n + i] = (even - decay * odd) * rate - odd * apart / (unit_s * unit_s)
            value[i] -= unit_s * (unit_s * (state[n + i] - rate) + 2.0 * zeta * (state[i] - begin)) / dt


@dataclass(frozen=True)
class TubeLine(Effect):
    """Second-order line, ``T^2 p'' + 2 zeta T p' + p = p_in``: a late, non-exponential rise, or ringing.

    ``period_s`` is ``2 pi T``, with which the line would ring if it had no friction.

    Notes
    -----
    Lumped inertance, resistance and compliance of a line (no equation number checked). Long narrow tubes have
    a tail of fractional order, which this does not have.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "second-order dynamics of the tube"
    kernel: ClassVar = tube_line_kernel
    flows: ClassVar[bool] = True
    piped: ClassVar[bool] = True
    extends: ClassVar[str] = "lag"

    period_s: float = parameter("s", 0.0, 6.3, 0.0, typical=0.6)
    damping_ratio: float = parameter("1", 0.1, 3.0, 1.0, typical=0.4)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return lines that ring at other periods: a fit finds its own only from a period nearby."""
        return [{"period_s": period, "damping_ratio": ratio} for period in (0.1, 0.2, 0.35, 1.2) for ratio in (0.2, 0.6)]

    @property
    def told_as(self) -> str:
        """A line that does not swing is two lags in a row: beside one that does as well it says nothing else."""
        return "lag" if self.damping_ratio >= 1.0 else ""

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (T s, damping ratio, chamber)."""
        return super().pack(robot) / [2.0 * math.pi, 1.0, 1.0]

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the pressures at the end of the line, then their rates of change, all zero."""
        return np.zeros(2 * robot.chambers)
