"""A regulator that also integrates its error: it overshoots, and the more the longer its flow was at its limit."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.free_motion import free_motion
from softrl.effects.way import mean_of_lag
from softrl.robots.robot import Robot

UNLIMITED = 1e4
LEAST_S = 1e-4  # the lag of a regulator that has none: its integral and the bound of its flow act all the same


@standing_as(SIGNAL_KERNEL)
def pi_regulator_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let the pressure follow the command; exact over ``dt`` while the flow is free. The state is pressures, then integrals.

    The mean lacks what the integral gains. At the lowest pressure an integral that asks for less is cut to what holds it there.
    """
    lag_s, integral_s, most, lowest, chamber = parameters[0], parameters[1], parameters[2] * dt, parameters[3], int(parameters[4])
    if lag_s <= 0.0 and math.isinf(integral_s) and math.isinf(parameters[2]):
        return
    lag_s = max(lag_s, LEAST_S)
    count, per_s = len(value), 1.0 / integral_s
    decay, stiff = 0.5 / lag_s, per_s / lag_s
    even, odd = free_motion(decay, decay * decay - stiff, dt)
    for i in range(count):
        if chamber < 0 or chamber == i:
            if dt <= 0.0:
                value[i] = state[i]
                continue
            begin, wound, error = state[i], state[count + i], value[i] - state[i]
            rate = (error + per_s * state[count + i]) / lag_s
            left = even * error + odd * (decay * error - rate)
            if abs(error - left) > most:
                left = error - math.copysign(most, error - left)
                state[count + i] += 0.5 * dt * (error + left)
            elif per_s > 0.0:
                rate = even * rate + odd * (stiff * error - decay * rate)
                state[count + i] = integral_s * (lag_s * rate - left)
            state[i] += error - left
            if state[i] < min(value[i], lowest):
                state[i] = min(value[i], lowest)
                if per_s > 0.0:
                    state[count + i] = max(state[count + i], -integral_s * (value[i] - state[i]))
                value[i] = 0.5 * (begin + state[i])
            elif abs(error - left) >= most:
                value[i] = 0.5 * (begin + state[i])
            elif per_s > 0.0:
                value[i] -= (state[count + i] - wound) / dt
            else:
                value[i] = mean_of_lag(value[i], begin, error - left, lag_s, dt)


@dataclass(frozen=True)
class PiRegulator(Effect):
    """Proportional and integral control of the pressure, ``dp/dt = (e + I / integral_s) / lag_s`` with ``dI/dt = e = p_cmd - p``.

    The flow is bounded by ``rate_per_s``, in the robot's largest pressure per second; at 1e4 there is no bound, and no
    integral part. While the flow is at its bound the integral goes on: it winds up. Below the robot's smallest pressure, or 0 if
    that is above it, it gets no chamber, and there the integral does not wind up.

    Notes
    -----
    Textbook control of an integrating plant, a chamber that a valve fills (no equation number checked). Without the integral
    it is a lag. Steps overshoot by 7 % where ``integral_s`` is ten times ``lag_s``, by 14 % at four times; below, they ring.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "regulator with an integral part, which overshoots"
    kernel: ClassVar = pi_regulator_kernel
    flows: ClassVar[bool] = True
    piped: ClassVar[bool] = True
    extends: ClassVar[str] = "rate_limit"
    contains: ClassVar[tuple[str, ...]] = ("lag",)
    essence: ClassVar[tuple[str, ...]] = ("integral_s",)

    lag_s: float = parameter("s", 0.0, 5.0, 0.0, typical=0.1)
    integral_s: float = parameter("s", 0.02, UNLIMITED, UNLIMITED, typical=0.5, log=True)
    rate_per_s: float = parameter(
        "1/s", 0.05, UNLIMITED, UNLIMITED, typical=UNLIMITED, log=True, default=UNLIMITED, of="pressure"
    )
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return quick and slow regulators, with free and with bounded flow: each rings at a period of its own."""
        return [
            {"lag_s": lag, "integral_s": integral, "rate_per_s": rate}
            for lag, integral in ((0.05, 0.1), (0.05, 0.4), (0.2, 0.3), (0.2, 1.5))
            for rate in (UNLIMITED, 2.0)
        ]

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the pressures and the integrals of their errors, all zero."""
        return np.zeros(2 * robot.chambers)

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (lag s, integral time s, largest rate Pa/s, lowest pressure Pa, chamber)."""
        lag_s, integral_s, rate, chamber = super().pack(robot)
        integral_s = integral_s if integral_s < UNLIMITED else np.inf
        most = rate * robot.largest_pa if rate < UNLIMITED else np.inf
        return np.array([lag_s, integral_s, most, robot.lowest_pa, chamber])
