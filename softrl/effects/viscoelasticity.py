"""A wall that relaxes: it creeps on under constant pressure."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.relaxation import relax, slots
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def viscoelasticity_kernel(
    parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool
) -> None:
    """Advance both branches' overstress."""
    relax(parameters, 2, state, port, dt, commit)


@dataclass(frozen=True)
class Viscoelasticity(Effect):
    """Prony series of two branches over the elastic resistance; the second is absent at ``share_2 = 0``.

    Notes
    -----
    Linear viscoelasticity in the form of a recursion for the overstress of each Maxwell branch (standard in
    finite-element texts; no equation number checked). The long-term stiffness is the model's; at once the
    wall resists ``1 + share_1 + share_2`` times as much. Under a constant pressure one branch creeps with the
    time constant ``relaxation (1 + share)``.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "viscoelastic relaxation and creep of the wall"
    kernel: ClassVar = viscoelasticity_kernel
    twins: ClassVar = (("share_1", "relaxation_1_s"), ("share_2", "relaxation_2_s"))

    share_1: float = parameter("1", 0.0, 5.0, 0.0, typical=0.4)
    relaxation_1_s: float = parameter("s", 0.02, 300.0, 1.0, typical=2.0, log=True)
    share_2: float = parameter("1", 0.0, 5.0, 0.0, typical=0.2)
    relaxation_2_s: float = parameter("s", 0.02, 300.0, 20.0, typical=20.0, log=True)
    chamber: int = -1

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the state of both branches at rest."""
        return np.zeros(slots(2, robot.chambers))

    def unrelaxed(self, after_s: float) -> float:
        """Return the shares of both branches that are left."""
        branches = (self.share_1, self.relaxation_1_s), (self.share_2, self.relaxation_2_s)
        return sum(share * math.exp(-after_s / tau) for share, tau in branches)
