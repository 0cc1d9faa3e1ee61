"""The symmetries of a robot's chamber layout."""

from typing import NamedTuple

import numpy as np

from softrl.robots.robot import Robot

SAME_RAD = 1e-6


class Symmetry(NamedTuple):
    """A turn or mirror about the z axis: ``coordinate`` (n + 3, n + 3) acts on loads and coordinates alike.

    ``vector`` (3, 3) acts on displacements; a rotation vector turns with ``vector`` times its determinant.
    """

    coordinate: np.ndarray
    vector: np.ndarray


def symmetries(direction: np.ndarray) -> list[Symmetry]:
    """Return the symmetries of chambers at ``direction`` (n, 2), turns and mirrors, the identity first.

    Notes
    -----
    Every symmetry sends the first chamber to some chamber, by a turn or by a mirror; those are tried, and kept when
    they send the whole layout onto itself. One chamber has its own mirror; three at equal angles have six symmetries.
    Of chambers one above the other, at one angle, none tells which goes where: they have the identity alone.
    """
    found = [_symmetry(np.eye(len(direction)), np.eye(2))]
    for sign in (1.0, -1.0):
        for target in direction:
            c, s = _quotient(target, direction[0], sign)
            plane = np.array([[c, -sign * s], [s, sign * c]])
            permutation = _permutation(direction, plane)
            if permutation is not None and not np.allclose(plane, np.eye(2)):
                found.append(_symmetry(permutation, plane))
    return found


def images_of(robot: Robot) -> list[Symmetry]:
    """Return the robot's symmetries besides the identity; they are about z."""
    return symmetries(robot.chamber_direction)[1:] if robot.axis in ("+z", "-z") else []


def _quotient(target: np.ndarray, first: np.ndarray, sign: float) -> tuple[float, float]:
    """Return cosine and sine of the turn that sends ``first`` (mirrored at x if ``sign`` < 0) to ``target``."""
    angle = np.arctan2(target[1], target[0]) - sign * np.arctan2(first[1], first[0])
    return float(np.cos(angle)), float(np.sin(angle))


def _permutation(direction: np.ndarray, plane: np.ndarray) -> np.ndarray | None:
    distance = np.linalg.norm((direction @ plane.T)[None] - direction[:, None], axis=2)
    permutation = (distance < SAME_RAD).astype(float)
    return permutation if (permutation.sum(axis=0) == 1.0).all() else None


def _symmetry(permutation: np.ndarray, plane: np.ndarray) -> Symmetry:
    n = len(permutation)
    vector = np.eye(3)
    vector[:2, :2] = plane
    coordinate = np.zeros((n + 3, n + 3))
    coordinate[:n, :n], coordinate[n:, n:] = permutation, vector
    return Symmetry(coordinate, vector)
