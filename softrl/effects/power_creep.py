"""A wall that creeps on all time scales at once: its relaxation follows a power of time."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import ADDED, ADDED_SLOPE, wall
from softrl.effects.relaxation import relax, slots
from softrl.robots.robot import Robot

MODES = 8
SHORTEST_S, FACTOR = 0.02, 5.0  # relaxation times 0.02, 0.1, .. 1560 s
TIMES_S = SHORTEST_S * FACTOR ** np.arange(MODES)


@standing_as(PORT_KERNEL)
def power_creep_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance every mode's overstress, and add what all slower ones resist."""
    relax(parameters, MODES, state, port, dt, commit)
    chamber, slower = int(parameters[2 * MODES]), parameters[2 * MODES + 1]
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            elastic, slope = wall(port, chamber, i)
            port[ADDED, i] += slower * elastic
            port[ADDED_SLOPE, i] += slower * slope


@dataclass(frozen=True)
class PowerCreep(Effect):
    """Relaxation modulus over the model's ``1 + share (t / 1 s)^-exponent``: creep without a time of its own.

    Notes
    -----
    Spring-pot beside the elastic wall (fractional Kelvin-Voigt, no equation number checked). The power is a sum of eight
    Maxwell modes, ``t^-a = 1 / Gamma(a) int tau^-a exp(-t / tau) d ln tau`` by the rectangle rule at relaxation times a
    factor 5 apart, and of a spring for all slower ones: within 10 % of the power from 0.1 to 300 s, level before and
    after.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "power-law (fractional) creep of the wall"
    kernel: ClassVar = power_creep_kernel
    variant_of: ClassVar[str] = "viscoelasticity"

    share: float = parameter("1", 0.0, 3.0, 0.0, typical=0.3)
    exponent: float = parameter("1", 0.05, 0.8, 0.3, typical=0.3, log=True)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return share and relaxation time of each mode in turn, the chamber, and the share of all slower modes."""
        modes, slower = self._shares()
        return np.array([*np.stack([modes, TIMES_S], axis=1).ravel(), super().pack(robot)[2], slower])

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the state of all modes at rest."""
        return np.zeros(slots(MODES, robot.chambers))

    def unrelaxed(self, after_s: float) -> float:
        """Return the shares of the modes that are left, and of all slower ones."""
        modes, slower = self._shares()
        return float(modes @ np.exp(-after_s / TIMES_S) + slower)

    def _shares(self) -> tuple[np.ndarray, float]:
        modes = self.share * math.log(FACTOR) / math.gamma(self.exponent) * TIMES_S**-self.exponent
        return modes, float(modes[-1] / (FACTOR**self.exponent - 1.0))  # the geometric series goes on
