"""A surface before the tip: elastic across, Coulomb friction along."""

from dataclasses import dataclass
from typing import ClassVar

import numba as nb
import numpy as np

from softrl.effects.effect import PORT_KERNEL, Effect
from softrl.effects.port import FORCE, FORCE_SLOPE, LOAD_PORT_ROWS, TIP
from softrl.robots.robot import Robot

STICK_SHARE = 0.5  # stiffness along the surface while the tip sticks, of that across it


@nb.njit(PORT_KERNEL, cache=True)
def surface_kernel(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Push the tip out along the normal; along the surface hold it by a spring that slips at Coulomb's limit.

    The state is the point (3) at which the spring is relaxed, and whether the tip touched at the last step.
    """
    normal, stiffness, friction = parameters[:3], parameters[4], parameters[5]
    depth = parameters[3]
    for k in range(3):
        depth -= normal[k] * port[TIP, k]
    if depth <= 0.0:
        if commit:
            state[3] = 0.0
        return
    press, grip = stiffness * depth, STICK_SHARE * stiffness
    across = 0.0
    stretch = np.zeros(3)
    for k in range(3):
        stretch[k] = port[TIP, k] - state[k] if state[3] > 0.0 else 0.0
        across += stretch[k] * normal[k]
    size = 0.0
    for k in range(3):
        stretch[k] -= across * normal[k]
        size += stretch[k] ** 2
    size = np.sqrt(size)
    share = 1.0 if grip * size <= friction * press else friction * press / (grip * size)
    for j in range(3):
        port[FORCE, j] += press * normal[j] - share * grip * stretch[j]
        for k in range(3):
            port[FORCE_SLOPE + j, k] -= stiffness * normal[j] * normal[k]
            port[FORCE_SLOPE + j, k] -= share * grip * ((1.0 if j == k else 0.0) - normal[j] * normal[k])
    if commit:
        for k in range(3):
            state[k] = port[TIP, k] - share * stretch[k]
        state[3] = 1.0


@dataclass(frozen=True)
class Surface(Effect):
    """A plane that the tip may press on.

    Attributes
    ----------
    normal : (3,) unit vector towards the robot;  point : (3,) m on the plane
    stiffness_n_per_m : across the plane
    friction : Coulomb's coefficient
    """

    site: ClassVar[str] = "load"
    title: ClassVar[str] = "surface before the tip"
    kernel: ClassVar = surface_kernel

    normal: tuple[float, float, float]
    point: tuple[float, float, float]
    stiffness_n_per_m: float
    friction: float

    def pack(self, robot: Robot) -> np.ndarray:
        """Return (normal (3,), height m along it, stiffness N/m, friction)."""
        return np.array([*self.normal, np.dot(self.normal, self.point), self.stiffness_n_per_m, self.friction])

    def reset(self, robot: Robot) -> np.ndarray:
        """Return (point of the relaxed spring (3,) m, touched)."""
        return np.zeros(4)

    def normal_force(self, position: np.ndarray) -> np.ndarray:
        """Return the force (steps,) N across the plane at tips (steps, 3) m."""
        depth = np.dot(self.normal, self.point) - position @ np.array(self.normal)
        return self.stiffness_n_per_m * np.maximum(depth, 0.0)


def force_on_tip(surface: Surface, robot: Robot, state: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return the force (3,) N of the surface on a tip at ``position``; ``state`` is left as it is."""
    port = np.zeros((LOAD_PORT_ROWS, 3))
    port[TIP] = position
    surface_kernel(surface.pack(robot), state, port, 1.0, False)
    return port[FORCE]
