"""Transport: what is commanded arrives some time later, as it was or a little spread."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.history import empty_history, look_back, push
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def dead_time_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Delay the command, then let what arrives lag twice; the state is the history, and the pressures behind each lag.

    Before the start it was zero. A lag in steps is late by less than its time constant: what both are late by is taken off.
    What arrives within a step is its mean at its end, too: a jump there would be the same for all delays in between.
    """
    n = len(value)
    first, second = state[len(state) - 2 * n : len(state) - n], state[len(state) - n :]
    delay, lag, chamber = parameters[0], parameters[1], int(parameters[2])
    if dt <= 0.0:
        for i in range(n):
            if chamber < 0 or chamber == i:
                value[i] = second[i]
        return
    push(state, value, False)
    share = 1.0 if lag <= 0.0 else -math.expm1(-dt / lag)
    steps = max(delay / dt - 2.0 * (1.0 - share) / share, 0.0)
    for i in range(n):
        if chamber < 0 or chamber == i:
            first[i] = (1.0 - share) * first[i] + share * look_back(state, n, i, steps)
            second[i] = (1.0 - share) * second[i] + share * first[i]
            value[i] = second[i]


@dataclass(frozen=True)
class DeadTime(Effect):
    """Delay between command and supply, ``p(t) = p_cmd(t - delay)``, or around it where the line disperses.

    Notes
    -----
    Textbook transport delay, and second order plus dead time of a line that disperses: ``delay_s`` is the mean time of
    arrival, ``dispersion`` its variance over ``delay_s`` squared, made by two equal lags after a shorter delay (no equation
    number checked). What spreads further is a lag or a tube. Exact for a delay of whole steps without dispersion,
    interpolated linearly between; steps shorter than delay / 4094 are refused.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "dead time between command and supplied pressure"
    kernel: ClassVar = dead_time_kernel
    shifts_time: ClassVar[bool] = True

    delay_s: float = parameter("s", 0.0, 1.0, 0.0, typical=0.1)
    dispersion: float = parameter("1", 0.0, 0.125, 0.0, typical=0.03, default=0.0)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (mean time of arrival s, time constant of each lag s, chamber)."""
        delay, dispersion, chamber = super().pack(robot)
        return np.array([delay, math.sqrt(0.5 * dispersion) * delay, chamber])

    def reset(self, robot: Robot) -> np.ndarray:
        """Return an empty history, and no pressure behind the lags."""
        return np.concatenate([empty_history(robot.chambers), np.zeros(2 * robot.chambers)])
