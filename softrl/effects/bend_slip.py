"""Joints, or layers along the body, that slip in the direction in which it bends, whichever chambers bend it."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.bending import Bending, resist, turned
from softrl.effects.effect import PORT_KERNEL
from softrl.robots.robot import Robot

ELEMENTS, FIRST = 4, 4.0 / 15.0  # that slip one after the other, each at twice the strain; the first's, over the mean


@standing_as(PORT_KERNEL)
def bend_slip_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance springs in series with sliders by what the bend turns and grows: each is drawn no farther than it yields."""
    moved_x, moved_y = turned(parameters, port, dt)
    yields, full = 0.5 * FIRST * parameters[1], 1.0 / (ELEMENTS * parameters[1])
    pull_x = pull_y = held_xx = held_xy = held_yy = 0.0
    for k in range(ELEMENTS):
        yields *= 2.0
        x, y = state[2 * k] + moved_x, state[2 * k + 1] + moved_y
        share = min(1.0, yields / max(math.hypot(x, y), 1e-300))
        x, y = share * x, share * y
        lost = share / yields**2 if share < 1.0 else 0.0  # of what slips: along itself it is drawn no farther
        pull_x, pull_y = pull_x + x, pull_y + y
        held_xx, held_xy, held_yy = held_xx + share - lost * x * x, held_xy - lost * x * y, held_yy + share - lost * y * y
        if commit:
            state[2 * k], state[2 * k + 1] = x, y
    resist(parameters, port, full * pull_x, full * pull_y, full * held_xx, full * held_xy, full * held_xy, full * held_yy)


@dataclass(frozen=True)
class BendSlip(Bending):
    """Hysteresis of the bend as a whole: a stress that follows the bend's vector until it slips along with it.

    ``height`` is what a chamber in the plane of the bend resists at most, as a share of the robot's largest pressure;
    ``yield_strain`` is the strain there at which the elements slip on average.

    Notes
    -----
    Sum of four elastoplastic elements of equal stiffness with radial return in the plane of bends (Prandtl and Iwan in two
    dimensions, textbook form, no equation number checked). Where every wall slips by itself (``hysteresis``, ``play``) two
    chambers that bend the body between them are seen to slip one by one, and those on the other side as well. What stretches
    the body meets nothing. Exact for any step in which the bend goes straight on.
    """

    title: ClassVar[str] = "slip along the bend"
    kernel: ClassVar = bend_slip_kernel

    def reset(self, robot: Robot) -> np.ndarray:
        """Return how far every element is drawn, x and y: not at all."""
        return np.zeros(2 * ELEMENTS)
