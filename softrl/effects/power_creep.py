"""A wall that creeps on all time scales at once: its relaxation follows a power of time."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import ADDED, ADDED_SLOPE, PORT_KERNEL, Effect, parameter, wall
from softrl.robots.robot import Robot

MODES = 8
SHORTEST_S, FACTOR = 0.02, 5.0  # relaxation times 0.02, 0.1, .. 1560 s
TIMES_S = SHORTEST_S * FACTOR ** np.arange(MODES)


@standing_as(PORT_KERNEL)
def power_creep_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance every mode's overstress exactly for a resistance that changes linearly over the step."""
    n, chamber = port.shape[1], int(parameters[MODES])
    if parameters[0] != 0.0:
        tau = TIMES_S[MODES - 1]
        faded = math.expm1(-dt / tau)
        for mode in range(MODES - 1, -1, -1):
            kept = -tau / dt * faded
            for i in range(n):
                if chamber < 0 or chamber == i:
                    elastic, slope = wall(port, chamber, i)
                    change = elastic - state[MODES * n + i]
                    overstress = (1.0 + faded) * state[mode * n + i] + kept * change
                    port[ADDED, i] += parameters[mode] * overstress
                    port[ADDED_SLOPE, i] += parameters[mode] * kept * slope
                    if commit:
                        state[mode * n + i] = overstress
            tau /= FACTOR
            # (1 + faded)^5 - 1: the next mode is five times as fast, and an exponential is what costs most here
            faded *= 5.0 + faded * (10.0 + faded * (10.0 + faded * (5.0 + faded)))
        for i in range(n):
            if chamber < 0 or chamber == i:
                elastic, slope = wall(port, chamber, i)
                port[ADDED, i] += parameters[MODES + 1] * elastic
                port[ADDED_SLOPE, i] += parameters[MODES + 1] * slope
    if commit:
        for i in range(n):
            state[MODES * n + i] = wall(port, chamber, i)[0]


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
        """Return the modes' shares (8,), the chamber, and the share of all slower modes."""
        modes, slower = self._shares()
        return np.array([*modes, super().pack(robot)[2], slower])

    def reset(self, robot: Robot) -> np.ndarray:
        """Return every mode's overstress and the last elastic resistance of each chamber, all zero."""
        return np.zeros((MODES + 1) * robot.chambers)

    def unrelaxed(self, after_s: float) -> float:
        """Return the shares of the modes that are left, and of all slower ones."""
        modes, slower = self._shares()
        return float(modes @ np.exp(-after_s / TIMES_S) + slower)

    def _shares(self) -> tuple[np.ndarray, float]:
        modes = self.share * math.log(FACTOR) / math.gamma(self.exponent) * TIMES_S**-self.exponent
        return modes, float(modes[-1] / (FACTOR**self.exponent - 1.0))  # the geometric series goes on
