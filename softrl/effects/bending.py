"""What laws of the bend as a whole share: how chambers' strains make a bend, and what resists it acts in chambers."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import borrowing
from softrl.effects.effect import Effect, parameter
from softrl.effects.port import ADDED, COUPLED, RATE
from softrl.robots.robot import Robot

FIRST = 3  # parameter of x by chambers' strains


@dataclass(frozen=True)
class Bending(Effect):
    """Hysteresis of the bend, whichever chambers make it.

    ``height`` is what a chamber in the plane of the bend resists at most, as a share of the robot's largest pressure;
    ``yield_strain`` is the strain there by which its law gives way.
    """

    site: ClassVar[str] = "body"
    variant_of: ClassVar[str] = "hysteresis"
    sticks: ClassVar[bool] = True

    height: float = parameter("1", 0.0, 1.0, 0.0, typical=0.1)
    yield_strain: float = parameter("1", 0.001, 0.3, 0.02, typical=0.02, log=True)

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (height Pa, yield strain, scale of a chamber's share in the pull, x and y of the bend by chamber strains)."""
        around = np.asarray(robot.chamber_direction)
        shape = np.hstack([np.ones((len(around), 1)), around]) if len(around) > 1 else around
        by_strains = np.linalg.pinv(shape)[-2:]
        own = super().pack(robot)[:2] * [robot.largest_pa, 1.0]
        return np.r_[own, 1.0 / np.linalg.norm(by_strains, axis=0).max(), by_strains.ravel()]


@borrowing
def turned(parameters: np.ndarray, port: np.ndarray, dt: float) -> tuple[float, float]:
    """Return by how much the bend has changed in the step, x and y, as strains of the outermost wall."""
    n, x, y = port.shape[1], 0.0, 0.0
    for i in range(n):
        x += parameters[FIRST + i] * port[RATE, i] * dt
        y += parameters[FIRST + n + i] * port[RATE, i] * dt
    return x, y


@borrowing
def resist(
    parameters: np.ndarray, port: np.ndarray, x: float, y: float, x_by_x: float, x_by_y: float, y_by_x: float, y_by_y: float
) -> None:
    """Add what a pull (x, y), at most 1 long, is in chambers, and from its slopes by the bend how they answer to each other.

    Chambers resist as the bend goes with their strains, so that no closed path gains work.
    """
    n, full = port.shape[1], parameters[0] * parameters[2]
    for i in range(n):
        by_x, by_y = full * parameters[FIRST + i], full * parameters[FIRST + n + i]
        port[ADDED, i] += by_x * x + by_y * y
        along_x, along_y = by_x * x_by_x + by_y * y_by_x, by_x * x_by_y + by_y * y_by_y
        for j in range(n):
            port[COUPLED + i, j] += along_x * parameters[FIRST + j] + along_y * parameters[FIRST + n + j]
