"""A gauge that follows the pressure slowly, at the end of a thin tube or behind a filter, or is read late."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.core.span import Span
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.effects.history import empty_history, look_back, push
from softrl.effects.way import share_of_lag
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def gauge_lag_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Advance ``dp_slow/dt = (p - p_slow) / time`` exactly over ``dt`` with the mean pressure held; report it late, at the end.

    The state is the history of what would be reported without delay, the step that it goes in, and ``p_slow`` as it is now.
    """
    n, time, chamber = len(value), parameters[0], int(parameters[2])
    slow, step = state[len(state) - n :], len(state) - n - 1
    if dt > 0.0:
        state[step], share = dt, share_of_lag(time, dt)
        for i in range(n):
            slow[i] += share * (value[i] - slow[i])
        return
    if time <= 0.0:
        for i in range(n):
            slow[i] = value[i]
    push(state, slow, False)
    for i in range(n):
        if chamber < 0 or chamber == i:
            value[i] = look_back(state, n, i, parameters[1] / state[step])


@dataclass(frozen=True)
class GaugeLag(Effect):
    """Reported chamber pressure of first order behind a delay, ``dp_reported/dt = (p(t - delay) - p_reported) / time``.

    Notes
    -----
    Textbook first-order model of a pressure gauge behind a line or a filter, and transport delay of what is polled (no equation
    number checked). The motion does not change under the same commands; in a replay that puts the measured pressure behind the
    valve, what acted was ahead of it. Exact for a delay of whole steps; steps shorter than delay / 4094 are refused.
    """

    site: ClassVar[str] = "sensor"
    channel: ClassVar[str] = "pressure"
    title: ClassVar[str] = "slow pressure gauge"
    kernel: ClassVar = gauge_lag_kernel
    flows: ClassVar[bool] = True
    essence: ClassVar[tuple[str, ...]] = ("time_s", "delay_s")

    time_s: float = parameter("s", 0.0, 2.0, 0.0, typical=0.1)
    delay_s: float = parameter("s", 0.0, 1.0, 0.0, typical=0.1, default=0.0)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return a gauge that is only slow, and one that is only late."""
        return [{"time_s": 0.1, "delay_s": 0.0}, {"time_s": 0.0, "delay_s": 0.1}]

    def reset(self, robot: Robot) -> np.ndarray:
        """Return an empty history, no step yet, and what gauges report at rest, zero."""
        return np.concatenate([empty_history(robot.chambers), np.zeros(1 + robot.chambers)])

    def undo(self, robot: Robot, reported: Span, share: np.ndarray, dt_s: float) -> Span:
        """Return the pressures that the gauge followed where it ``reported`` these, ``dt_s`` apart.

        What it had not yet reported at the end is taken to stay as it was.
        """
        time, seen = dt_s * np.arange(len(reported.end)), Span(*(np.array(part, dtype=float) for part in reported))
        for c in range(robot.chambers) if self.chamber < 0 else (self.chamber,):
            mean, end = (part[:, c] for part in reported)
            if self.time_s > 0.0:
                gained = np.diff(end, prepend=end[0])
                mean = end - gained + gained / -math.expm1(-dt_s / self.time_s)
                end = 0.5 * (mean + np.append(mean[1:], mean[-1]))
            for part, quick, shown in zip(seen, (mean, end), reported, strict=True):
                part[:, c] += share[:, 0] * (np.interp(time + self.delay_s, time, quick) - shown[:, c])
        return seen
