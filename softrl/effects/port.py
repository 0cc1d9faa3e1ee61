"""What a body and its effects tell each other inside an implicit step, and how a wall's resistance is read and changed there."""

import numba as nb
import numpy as np

from softrl.core.compiled import borrowing

# rows of a body port (10 + chambers, chambers): one column per chamber
STRAIN, RATE, ELASTIC, ELASTIC_SLOPE, PRESSURE, REST, ADDED, ADDED_SLOPE, CHANGED, UNEVEN, COUPLED = range(11)
# STRAIN         chamber elongation e_i relative to rest, dimensionless (trial value)
# RATE           (e_i - e_i at the last step) / dt, 1/s
# ELASTIC        elastic resisting pressure of the bare body, Pa, zero at rest;  ELASTIC_SLOPE  its derivative by e_i, Pa
# PRESSURE       pressure that acts in the chamber, Pa;  REST  stiffness of the wall beside it, at rest, Pa
# ADDED          output: further resisting pressure, Pa (positive resists elongation);  ADDED_SLOPE  d ADDED / d e_i, Pa
# CHANGED        in/out: by what share of itself the elastic resistance has changed: laws that multiply it do so in turn
# UNEVEN         in/out: the same of what the bare body resists beside the chambers' mean strains, where all walls have changed
# COUPLED .. +i  output: d ADDED_i / d e_j, Pa, beside that slope, of what answers in one chamber to strains of others

# rows of a load port (7, 3)
TIP, TIP_VELOCITY, GRAVITY, FORCE, FORCE_SLOPE = 0, 1, 2, 3, 4
# TIP            trial tip position, m;  TIP_VELOCITY  m/s
# GRAVITY        in/out: gravity felt by the body, m/s^2 (a tilt rotates it)
# FORCE          output: further force on the tip, N;  FORCE_SLOPE .. +2  output: d FORCE / d TIP, N/m (rows: force)

LOAD_PORT_ROWS = 7


@nb.njit(cache=True)
def body_port(chambers: int) -> np.ndarray:
    """Return an empty body port."""
    return np.zeros((COUPLED + chambers, chambers))


@borrowing
def clear(port: np.ndarray) -> None:
    """Take out of a body port what effects have put in."""
    for row in range(ADDED, port.shape[0]):
        for i in range(port.shape[1]):
            port[row, i] = 0.0


@borrowing
def slope_of(port: np.ndarray, i: int, j: int) -> float:
    """Return by how much chamber ``i`` resists more, Pa, for each unit by which the strain of chamber ``j`` grows."""
    return port[COUPLED + i, j] + (port[ADDED_SLOPE, i] if i == j else 0.0)


@borrowing
def wall(port: np.ndarray, chamber: int, i: int) -> tuple[float, float]:
    """Return the elastic resistance, Pa, of the wall beside chamber ``i``, and its slope, Pa, as an effect of ``chamber`` has it.

    The whole body resists as it does; what is said of one chamber alone is said of a spring of its own. The pressure that
    holds a chamber in its place is in part that of the others' walls, which do not change with its own.
    """
    if chamber < 0:
        return port[ELASTIC, i], port[ELASTIC_SLOPE, i]
    return port[REST, i] * port[STRAIN, i], port[REST, i]


@borrowing
def multiply_wall(port: np.ndarray, chamber: int, i: int, more: float, slope: float) -> None:
    """Add the share ``more``, which changes by ``slope`` per strain, of what such laws before have left of ``wall``."""
    elastic, stiff = wall(port, chamber, i)
    left = 1.0 + port[CHANGED, i]
    port[ADDED, i] += left * more * elastic
    port[ADDED_SLOPE, i] += left * (more * stiff + slope * elastic)
    port[CHANGED, i] += left * more


@borrowing
def multiply_body(port: np.ndarray, chamber: int, i: int, more: float) -> None:
    """Do what ``multiply_wall`` does where ``more`` holds for all that chamber ``i`` does, however it is strained."""
    multiply_wall(port, chamber, i, more, 0.0)
    port[UNEVEN, i] += (1.0 + port[UNEVEN, i]) * more


@borrowing
def share_of_all(port: np.ndarray) -> float:
    """Return by what share all walls have changed: the least of ``UNEVEN``, none where some are stiffer and some softer."""
    least = port[UNEVEN, 0]
    for i in range(1, port.shape[1]):
        if port[UNEVEN, i] * least <= 0.0:
            return 0.0
        if abs(port[UNEVEN, i]) < abs(least):
            least = port[UNEVEN, i]
    return least
