"""How a body's coordinates stretch its chambers, and what of its stiffness stands beside each."""

from functools import cache

import numpy as np


def strains_of(angles_deg: tuple[float, ...], lever: float) -> np.ndarray:
    """Return the chambers' strains (chambers, 3) per (b_x, b_y, epsilon), ``lever`` being their radius over the length."""
    angle = np.deg2rad(angles_deg)
    return np.stack([-lever * np.cos(angle), -lever * np.sin(angle), np.ones(len(angle))], axis=1)


@cache
def maps_of(angles_deg: tuple[float, ...], lever: float, planar: bool) -> tuple[np.ndarray, ...]:
    """Return the plane (2,) of a ``planar`` body, and the strains (chambers, moving) of the coordinates that stretch chambers.

    Those are all three, or the bend in the plane of the one chamber.
    """
    strain, plane = strains_of(angles_deg, lever), np.zeros(2)
    if planar:
        plane = strain[0, :2] / lever
        strain = strain[:, :2] @ plane[:, None]
    return plane, np.ascontiguousarray(strain)


def moving_of(to_strain: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the coordinates (moving, chambers) of least energy for strains, with ``stiffness`` (moving,) J.

    Two chambers leave one coordinate open. Any other choice would mix bends and elongation by their units, and walls that follow
    what holds the chambers would gain work along a closed path.
    """
    root = np.sqrt(stiffness)
    return np.linalg.pinv(to_strain / root) / root[:, None]


def wall_of(to_strain: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the stiffnesses (chambers,) J of the walls beside the chambers, whose strains are ``to_strain`` (chambers, moving).

    Equal walls that all together bear the bending, in the plane where they bear most: what holds a body's length need not be
    its walls. But none is stiffer than the body is to one chamber's pressure, so that a body without one of them still stands.
    """
    bent = to_strain[:, :2]
    alike = stiffness[0] / np.linalg.eigvalsh(bent.T @ bent)[-1]
    return np.minimum(alike, 1.0 / np.sum(to_strain**2 / stiffness, axis=1))
