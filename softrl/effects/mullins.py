"""A wall that has grown softer up to where it was stretched before."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import STRAIN, multiply_wall

LONG_S = 1e6  # after which nothing recovers within any recording


@standing_as(PORT_KERNEL)
def mullins_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Take away a share of the elastic resistance, growing with how far its energy is below the largest so far."""
    softening, square, chamber = parameters[0], parameters[1] * parameters[1], int(parameters[3])
    faded = math.exp(-dt / parameters[2])
    for i in range(port.shape[1]):
        if chamber >= 0 and chamber != i:
            continue
        strain = port[STRAIN, i]
        largest = max(faded * state[i], strain * strain)
        kept = math.exp((strain * strain - largest) / square)
        lost = softening * (1.0 - kept)
        regained = 2.0 * softening * kept * strain / square if strain * strain < largest else 0.0
        multiply_wall(port, chamber, i, -lost, regained)
        if commit:
            state[i] = largest


@dataclass(frozen=True)
class Mullins(Effect):
    """Softening below the largest strain e so far: ``1 - softening (1 - exp((e^2 - e_max^2) / width^2))`` of the resistance.

    Notes
    -----
    After the idea of pseudo-elasticity: damage by how far the stored energy, here the square of the strain, is below its
    running maximum (no equation number checked). On virgin loading it vanishes. With rest it recovers: the remembered energy
    fades with the time ``recovery_s``.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "softening below the largest strain so far (Mullins)"
    kernel: ClassVar = mullins_kernel

    softening: float = parameter("1", 0.0, 0.8, 0.0, typical=0.3)
    width: float = parameter("1", 0.002, 0.5, 0.05, typical=0.05, log=True)
    recovery_s: float = parameter("s", 10.0, LONG_S, LONG_S, typical=LONG_S, default=LONG_S, log=True)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return one that recovers."""
        return [{"recovery_s": 200.0}]
