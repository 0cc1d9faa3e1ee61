"""A body whose stiffness changes slowly through a run, whatever it does."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import ADDED, ADDED_SLOPE, ELASTIC, ELASTIC_SLOPE, PORT_KERNEL, Effect, parameter
from softrl.robots.robot import Robot


@nb.njit(PORT_KERNEL, cache=True)
def drift_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Scale the elastic resistance by ``exp(-rate t)`` with the time t since the onset."""
    chamber = int(parameters[2])
    change = math.expm1(-parameters[0] * max(state[0] + dt - parameters[1], 0.0))
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            port[ADDED, i] += change * port[ELASTIC, i]
            port[ADDED_SLOPE, i] += change * port[ELASTIC_SLOPE, i]
    if commit:
        state[0] += dt


@dataclass(frozen=True)
class Drift(Effect):
    """Softening (positive) or stiffening at a constant relative rate: warming, ageing within a run.

    Notes
    -----
    Stiffness over the model's is ``exp(-rate (t - onset))`` from ``onset_s`` after the start of the run on, and 1
    before (an empirical form, no equation number checked); nothing is carried from run to run.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "slow drift of the stiffness"
    kernel: ClassVar = drift_kernel
    clock: ClassVar = 0

    rate_per_s: float = parameter("1/s", -0.01, 0.01, 0.0, typical=0.003)
    onset_s: float = parameter("s", 0.0, 600.0, 0.0, typical=0.0, default=0.0)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the time since the start, s."""
        return np.zeros(1)
