"""A body whose stiffness changes slowly through a run, whatever it does."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import ANY_MOMENT_S, PORT_KERNEL, Effect, parameter
from softrl.effects.port import multiply_body
from softrl.robots.robot import Robot

LONG_S = 1e6  # after which it levels off no more within any recording
MOST = 5.0  # logarithm of a stiffness over the model's, beyond which nobody calls it a drift


@standing_as(PORT_KERNEL)
def drift_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Scale the elastic resistance by ``exp(-rate T (1 - exp(-t / T)))`` with the time t since the onset."""
    chamber = int(parameters[3])
    since = max(state[0] + dt - parameters[1], 0.0)
    change = math.expm1(min(parameters[0] * parameters[2] * math.expm1(-since / parameters[2]), MOST))
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            multiply_body(port, chamber, i, change)
    if commit:
        state[0] += dt


@dataclass(frozen=True)
class Drift(Effect):
    """Softening (positive) or stiffening at a relative rate, which may level off: warming, ageing within a run.

    Notes
    -----
    With the time t since ``onset_s`` after the start of the run, stiffness over the model's is ``exp(-rate T (1 -
    exp(-t / T)))``, and 1 before: what warms comes to an end as its surroundings take up the heat (Newton's law of
    cooling; no equation number checked). With ``levels_s`` T long it goes on for ever. From run to run it goes on where
    the clock does (``begun_s``): a wall that ages, a day that warms up.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "slow drift of the stiffness"
    kernel: ClassVar = drift_kernel
    clock: ClassVar = 0
    lasts: ClassVar[bool] = True

    rate_per_s: float = parameter("1/s", -0.05, 0.05, 0.0, typical=0.003)
    onset_s: float = parameter("s", 0.0, ANY_MOMENT_S, 0.0, typical=0.0, default=0.0, scale=60.0)
    levels_s: float = parameter("s", 1.0, LONG_S, LONG_S, typical=LONG_S, default=LONG_S, log=True)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return drifts that level off."""
        return [{"rate_per_s": 0.01, "levels_s": levels} for levels in (10.0, 40.0)]

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the time since the start, s."""
        return np.zeros(1)
