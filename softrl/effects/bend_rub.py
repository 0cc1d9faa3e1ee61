"""Joints, or layers along the body, that rub as it bends, whichever chambers bend it: a resistance that levels off smoothly."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.bending import Bending, resist, turned
from softrl.effects.effect import PORT_KERNEL
from softrl.robots.robot import Robot


@standing_as(PORT_KERNEL)
def bend_rub_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance the pull (x, y) exactly along the way that the bend goes in the step, towards the direction in which it goes."""
    moved_x, moved_y = turned(parameters, port, dt)
    per = 1.0 / parameters[1]
    way = math.hypot(moved_x, moved_y)
    kept = math.exp(-way * per)
    still = way < 1e-12 * parameters[1]  # then no way is told, and bristles are bent as if all stood upright
    along_x, along_y = (0.0, 0.0) if still else (moved_x / way, moved_y / way)
    across = per if still else (1.0 - kept) / way  # what a turn of the way does, per strain
    behind_x, behind_y = state[0] - along_x, state[1] - along_y
    further = kept * per
    resist(
        parameters, port, along_x + kept * behind_x, along_y + kept * behind_y,
        across * (1.0 - along_x * along_x) - further * behind_x * along_x,
        -across * along_x * along_y - further * behind_x * along_y,
        -across * along_x * along_y - further * behind_y * along_x,
        across * (1.0 - along_y * along_y) - further * behind_y * along_y,
    )  # fmt: skip
    if commit:
        state[0], state[1] = along_x + kept * behind_x, along_y + kept * behind_y


@dataclass(frozen=True)
class BendRub(Bending):
    """Dahl's friction of the bend as a whole: ``dz = db / yield_strain - z |db| / yield_strain``, z and b in the plane.

    ``height`` is what a chamber in the plane of the bend resists at most, as a share of the robot's largest pressure; after a
    turn of the way, ``yield_strain`` of motion there leaves 1/e of what was before.

    Notes
    -----
    Dahl's model of exponent 1 for motion in a plane, as in the bristles of LuGre's (textbook form, no equation number checked).
    Right after a reversal it is twice as stiff as in Bouc and Wen's form (``hysteresis``), and has no corners, where
    ``bend_slip`` has four. What stretches the body meets nothing. Exact for any step in which the bend goes straight on.
    """

    title: ClassVar[str] = "rubbing along the bend"
    kernel: ClassVar = bend_rub_kernel

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the pull, x and y, at most 1 long: none."""
        return np.zeros(2)
