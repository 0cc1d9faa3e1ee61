"""A wall that gives way and then locks, as rubber does: its curve of pressure over strain is S-shaped."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.strain_softening import strain_softening_kernel
from softrl.effects.strain_stiffening import strain_stiffening_kernel
from softrl.robots.robot import Robot

SOFTENS = 3  # numbers that ``strain_softening`` reads, which come first


@standing_as(PORT_KERNEL)
def locking_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Let the wall level off, and add a spring that is stiffer by a power of the elongation."""
    strain_softening_kernel(parameters[:SOFTENS], state, port, dt, commit)
    strain_stiffening_kernel(parameters[SOFTENS:], state, port, dt, commit)


@dataclass(frozen=True)
class Locking(Effect):
    """The resistance of ``strain_softening``, and beyond it the spring of ``strain_stiffening``.

    It gives way at the robot's largest pressure over ``softness``, and ``growth`` is the spring's share of the stiffness at
    rest at 10 % elongation.

    Notes
    -----
    Chains of rubber that come to their full length, folds that open, fabric drawn straight: soft between two stiff branches
    (an empirical form, no equation number checked). Either law alone bends one way only, and beside a curve that bends both
    ways neither shows without the other. Static, odd in strain, without memory.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "a wall that gives way and then locks"
    kernel: ClassVar = locking_kernel
    contains: ClassVar[tuple[str, ...]] = ("strain_softening", "strain_stiffening")
    essence: ClassVar[tuple[str, ...]] = ("softness", "growth")
    undivided: ClassVar[bool] = True

    softness: float = parameter("1", 0.0, 20.0, 0.0, typical=2.0)
    residual: float = parameter("1", 0.0, 1.0, 0.0, typical=0.03, default=0.0)
    growth: float = parameter("1", 0.0, 50.0, 0.0, typical=0.05, default=0.0)
    power: float = parameter("1", 0.5, 6.0, 2.0, typical=2.0, log=True, default=2.0)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (softness 1/Pa, residual, chamber, growth, power, chamber)."""
        softness, residual, growth, power, chamber = super().pack(robot)
        return np.array([softness / robot.largest_pa, residual, chamber, growth, power, chamber])
