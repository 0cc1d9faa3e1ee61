"""How large a measured pressure is beside the command that it follows."""

import numpy as np

from softrl.robots.robot import Robot

MIN_SHARE = 0.1  # of the pressure range, or of the largest motion of any run: less says nothing
FOLLOWS = 0.8  # correlation of a pressure with the command that it follows
UNIT_FACTOR = 3.0  # by which a measured pressure may differ from the command that it follows, and a tip from its model


def scale_of(command: np.ndarray, measured: np.ndarray, robot: Robot) -> float:
    """Return how many times as large as ``command`` (steps,) Pa a pressure (steps,) Pa that follows it is, or 1 if it does not.

    Of the slopes over all commands and over the lower half of them the one nearer 1: a supply that gives no more than so much
    bends the line, a wrong unit does not.
    """
    least = MIN_SHARE * (robot.pressure_max_pa - robot.pressure_min_pa)
    if np.ptp(command) < least or correlation(command, measured) < FOLLOWS:
        return 1.0
    low = command <= 0.5 * (command.min() + command.max())
    parts = [np.ones_like(low), low] if np.ptp(command[low]) > least else [np.ones_like(low)]
    slopes = [float(np.polyfit(command[part], measured[part], 1)[0]) for part in parts]
    return min(slopes, key=lambda slope: abs(np.log(max(slope, 1e-12))))


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Return the correlation of two series (steps,), 0 where one of them stands still."""
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b / max(float(np.sqrt((a @ a) * (b @ b))), 1e-300))
