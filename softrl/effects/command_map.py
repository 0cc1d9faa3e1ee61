"""A bent map between recorded commands and supplied pressures, as a calibration leaves it."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.core.errors import ConfigError
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot

CHAMBERS = 3


@standing_as(SIGNAL_KERNEL)
def command_map_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Add the matrix times the commands, the shifts, and the bends, down to the lowest; the state is the commands."""
    count, lowest = len(value), parameters[CHAMBERS * CHAMBERS + 2 * CHAMBERS]
    for i in range(count):
        state[i] = value[i]
    for i in range(count):
        value[i] += parameters[CHAMBERS * CHAMBERS + i]
        value[i] += parameters[CHAMBERS * CHAMBERS + CHAMBERS + i] * state[i] * abs(state[i])
        for j in range(count):
            value[i] += parameters[CHAMBERS * i + j] * state[j]
        value[i] = max(value[i], min(state[i], lowest))


@dataclass(frozen=True)
class CommandMap(Effect):
    """Supplied pressure ``p_i + sum_j a_ij p_j + b_i p_max + c_i p_i |p_i| / p_max`` of commands p.

    It is what a map fitted beforehand has put in or taken, and goes no lower than the robot's smallest pressure.

    Notes
    -----
    Where a calibration was fitted to the same robot, the pressures that a simulator is given are not those that the robot
    got, and part of the physics that is missing hides in the difference (first-order form of any smooth map, and of the
    second order what bends each chamber's own line; no equation number checked). Robots of up to three chambers.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "calibration map between commands and pressures"
    kernel: ClassVar = command_map_kernel
    together: ClassVar[bool] = True

    a_11: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_12: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_13: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_21: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_22: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_23: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_31: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_32: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    a_33: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1)
    b_1: float = parameter("1", -0.3, 0.3, 0.0, typical=0.05, of="pressure")
    b_2: float = parameter("1", -0.3, 0.3, 0.0, typical=0.05, of="pressure")
    b_3: float = parameter("1", -0.3, 0.3, 0.0, typical=0.05, of="pressure")
    c_1: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1, default=0.0)
    c_2: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1, default=0.0)
    c_3: float = parameter("1", -0.5, 0.5, 0.0, typical=0.1, default=0.0)

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether there are chambers to mix, and few enough."""
        return 1 < robot.chambers <= CHAMBERS

    def pack(self, robot: Robot) -> np.ndarray:
        """Return the matrix, the shifts in Pa, the bends per Pa, and the lowest pressure in Pa."""
        if robot.chambers > CHAMBERS:
            raise ConfigError(f"effect command_map knows {CHAMBERS} chambers; robot {robot.name} has {robot.chambers}")
        values = super().pack(robot)[:-1]
        first = CHAMBERS * CHAMBERS
        values[first : first + CHAMBERS] *= robot.largest_pa
        values[first + CHAMBERS :] /= robot.largest_pa
        return np.append(values, robot.lowest_pa)
