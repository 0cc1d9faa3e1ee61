"""What laws of the bend as a whole share: how chambers' strains make a bend, and what resists it acts in chambers.

Their parameters are a height in Pa, a strain, by how much a pull at full height acts in a chamber, and x and y of the bend by
each chamber's strain.
"""

import numpy as np

from softrl.core.compiled import borrowing
from softrl.effects.effect import ADDED, COUPLED, RATE
from softrl.robots.robot import Robot

FIRST = 3  # parameter of x by chambers' strains


def packed(robot: Robot, height: float, strain: float) -> np.ndarray:
    """Return the parameters (3 + 2 chambers,); in the plane of the bend a chamber resists by ``height`` largest pressures."""
    around = np.asarray(robot.chamber_direction)
    shape = np.hstack([np.ones((len(around), 1)), around]) if len(around) > 1 else around
    by_strains = np.linalg.pinv(shape)[-2:]
    return np.r_[height * robot.largest_pa, strain, 1.0 / np.linalg.norm(by_strains, axis=0).max(), by_strains.ravel()]


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
