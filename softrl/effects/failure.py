"""A chamber that gives way in the middle of a run."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import ANY_MOMENT_S, SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@standing_as(SIGNAL_KERNEL)
def failure_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Take away a share of the pressure from the onset on; in the step of the onset, and at its end, in proportion.

    The state is the clock, and the share of the loss that acted in the last step: a jump at its end would tell the onset to the
    step only.
    """
    loss, onset, chamber = parameters[0], parameters[1], int(parameters[2])
    if dt > 0.0:
        state[0] += dt
        state[1] = min(max((state[0] - onset) / dt, 0.0), 1.0)
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            value[i] *= 1.0 - loss * state[1]


@dataclass(frozen=True)
class Failure(Effect):
    """Acting pressure ``(1 - loss) p`` from ``onset_s`` after the start of each run on, and ``p`` before.

    Notes
    -----
    A puncture, a kinked tube, a torn layer, as a step in time (an empirical form, no equation number checked). A run that
    ends before the onset shows nothing. Where it lasts, the clock goes on from run to run (``begun_s``).
    """

    site: ClassVar[str] = "chamber"
    title: ClassVar[str] = "failure of a chamber during the run"
    kernel: ClassVar = failure_kernel
    gauged: ClassVar[bool] = True
    clock: ClassVar = 0
    lasts: ClassVar[bool] = True
    onset_of: ClassVar[str] = "gain"

    loss: float = parameter("1", 0.0, 1.0, 0.0, typical=0.4)
    onset_s: float = parameter("s", 0.0, ANY_MOMENT_S, 5.0, typical=5.0, scale=60.0)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the clock, s, and the share of the loss that acts."""
        return np.zeros(2)
