"""Dry friction between layers of the wall, or against a sleeve."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import standing_as
from softrl.effects.effect import PORT_KERNEL, Effect, parameter
from softrl.effects.port import ADDED, ADDED_SLOPE, PRESSURE, RATE
from softrl.robots.robot import Robot

YIELD_STRAIN = 1e-3  # by which a stuck wall gives way at full pressure: a hundredth of what robots show, yet a slope that is met


@standing_as(PORT_KERNEL)
def friction_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Advance a spring in series with a slider, whose height follows the pressure; the state is its stress, Pa."""
    dry, loaded, slope, chamber = parameters[0], parameters[1], parameters[2], int(parameters[3])
    for i in range(port.shape[1]):
        if chamber < 0 or chamber == i:
            height = dry + loaded * abs(port[PRESSURE, i])
            stress = state[i] + slope * port[RATE, i] * dt
            held = min(max(stress, -height), height)
            port[ADDED, i] += held
            if held == stress:
                port[ADDED_SLOPE, i] += slope
            if commit:
                state[i] = held


@dataclass(frozen=True)
class Friction(Effect):
    """Coulomb friction: a share of the robot's largest pressure plus a share of the acting pressure.

    It holds for as long as it is held. What is stored while it sticks is at most ``dry + loaded |p|``, and what is beyond that
    as the pressure falls slips away.

    Notes
    -----
    Prandtl's elastoplastic element: ``ds/de = k`` within ``|s| < dry + loaded |p|``, else it slips (textbook form, no equation
    number checked). ``k`` is constant, such that a stuck wall gives way by a strain of 1e-3 at the robot's largest pressure:
    so it takes energy in every loop, whatever the pressure does. Exact for any step in which the strain does not turn.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "dry friction in the wall"
    kernel: ClassVar = friction_kernel
    sticks: ClassVar[bool] = True

    dry: float = parameter("1", 0.0, 0.5, 0.0, typical=0.05)
    loaded: float = parameter("1", 0.0, 0.5, 0.0, typical=0.05)
    chamber: int = -1

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (dry Pa, loaded, stiffness while it sticks Pa, chamber)."""
        dry, loaded, chamber = super().pack(robot)
        return np.array([dry * robot.largest_pa, loaded, (dry + loaded) * robot.largest_pa / YIELD_STRAIN, chamber])
