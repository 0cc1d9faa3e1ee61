"""A wall that is softer, or stiffer, the warmer it is."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import multiply_body
from softrl.robots.robot import Robot

NEUTRAL_C = 20.0  # at which the wall is as stiff as the model's
MOST = 5.0  # logarithm of a stiffness over the model's, beyond which no wall is a wall
OWN = 2  # numbers of the effect itself: softening 1/K and chamber; the temperatures, one a second, stand behind them


@standing_as(PORT_KERNEL)
def thermal_softening_kernel(
    parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool
) -> None:
    """Scale the elastic resistance by ``exp(-a (T - 20 C))``, T between its values at whole seconds; without any, by 1."""
    chamber, count = int(parameters[1]), len(parameters) - OWN
    now = min(max(state[0] + dt, 0.0), count - 1.0)
    if count > 0:
        left = min(int(now), max(count - 2, 0))
        share = now - left
        warm = (1.0 - share) * parameters[OWN + left] + share * parameters[OWN + min(left + 1, count - 1)]
        change = math.expm1(min(max(-parameters[0] * (warm - NEUTRAL_C), -MOST), MOST))
        for i in range(port.shape[1]):
            if chamber < 0 or chamber == i:
                multiply_body(port, chamber, i, change)
    if commit:
        state[0] += dt


@dataclass(frozen=True)
class ThermalSoftening(Effect):
    """Stiffness that falls (positive) or rises with the recorded temperature T, ``exp(-a (T - 20 C))`` times the model's.

    Notes
    -----
    Linear in the temperature for a few kelvin: rubber elasticity rises with the absolute temperature, by 0.34 % per kelvin,
    while the damping and filled networks of silicones and polyurethanes soften (textbook thermoelasticity; no equation
    number checked). It needs the temperature along the run; where none is recorded, as in training a policy, it does nothing.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "stiffness that changes with the temperature"
    kernel: ClassVar = thermal_softening_kernel
    clock: ClassVar = 0
    needs: ClassVar[str] = "temperature"

    softening_per_k: float = parameter("1/K", -0.1, 0.1, 0.0, typical=0.02)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the time since the start, s."""
        return np.zeros(1)
