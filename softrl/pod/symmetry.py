"""The symmetries of a robot's chamber layout, and what they make of equilibria."""

from typing import NamedTuple

import numpy as np

from softrl.artifacts.snapshots import Snapshots
from softrl.robots.robot import Robot

SAME_RAD = 1e-6


class Symmetry(NamedTuple):
    """A turn or mirror about the z axis: ``coordinate`` (n + 3, n + 3) acts on loads and coordinates alike.

    ``vector`` (3, 3) acts on displacements; a rotation vector turns with ``vector`` times its determinant.
    """

    coordinate: np.ndarray
    vector: np.ndarray


class Equilibria(NamedTuple):
    """What the energy fit reads of the snapshots; first axis samples, units as there."""

    load: np.ndarray
    coordinate: np.ndarray
    energy: np.ndarray
    compliance: np.ndarray
    compliance_slope: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    lag_stiffness: np.ndarray
    lag_viscosity: np.ndarray
    lag_spin: np.ndarray
    centre_of_mass: np.ndarray
    centre_slope: np.ndarray
    give: np.ndarray
    give_spin: np.ndarray
    give_mass: np.ndarray
    give_coupling: np.ndarray
    rotation: np.ndarray
    rotation_slope: np.ndarray

    def rows(self, index: np.ndarray | slice) -> "Equilibria":
        """Return the samples ``index``."""
        return Equilibria(*(values[index] for values in self))


def equilibria(snapshots: Snapshots) -> Equilibria:
    """Return the equilibria of ``snapshots``, the plate's orientation as rotation vector (samples, 3) rad."""
    inverse = np.linalg.inv(snapshots.compliance)
    on_coordinate = [inverse @ tangent @ inverse for tangent in (snapshots.tangent_stiffness, snapshots.tangent_mass)]
    return Equilibria(
        snapshots.loads,
        snapshots.coordinate,
        snapshots.energy,
        snapshots.compliance,
        snapshots.compliance_slope,
        *on_coordinate,
        snapshots.lag_stiffness,
        snapshots.lag_viscosity,
        snapshots.lag_spin,
        snapshots.centre_of_mass,
        snapshots.centre_slope,
        snapshots.give,
        snapshots.give_spin,
        snapshots.give_mass,
        snapshots.give_coupling @ inverse,
        rotation := rotation_vector(snapshots.tip_quaternion),
        per_spin(rotation) @ snapshots.tip_spin,
    )


def rotation_vector(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (samples, 3) rad of ``quaternion`` (samples, 4) w x y z, turning by at most pi."""
    quaternion = np.where(quaternion[:, :1] < 0.0, -quaternion, quaternion)
    sine = np.linalg.norm(quaternion[:, 1:], axis=1)
    half = np.arctan2(sine, quaternion[:, 0])
    factor = np.where(sine > 1e-9, 2.0 * half / np.where(sine > 1e-9, sine, 1.0), 2.0)
    return quaternion[:, 1:] * factor[:, None]


def per_spin(rotation: np.ndarray) -> np.ndarray:
    """Return d rotation vector / d spin (samples, 3, 3) at rotation vectors (samples, 3), of less than a whole turn."""
    angle = np.linalg.norm(rotation, axis=1)[:, None, None]
    half = np.maximum(0.5 * angle, 1e-6)
    cross = np.cross(rotation[:, None, :], np.eye(3)).transpose(0, 2, 1)  # rotation x
    bend = np.where(angle > 1e-4, (1.0 - half / np.tan(half)) / np.maximum(angle, 1e-9) ** 2, 1.0 / 12.0)
    return np.eye(3) - 0.5 * cross + bend * cross @ cross


def symmetries(direction: np.ndarray) -> list[Symmetry]:
    """Return the symmetries of chambers at ``direction`` (n, 2), turns and mirrors, the identity first.

    Notes
    -----
    Every symmetry sends the first chamber to some chamber, by a turn or by a mirror; those are tried, and kept when
    they send the whole layout onto itself. One chamber has its own mirror; three at equal angles have six symmetries.
    """
    found = []
    for sign in (1.0, -1.0):
        for target in direction:
            c, s = _quotient(target, direction[0], sign)
            plane = np.array([[c, -sign * s], [s, sign * c]])
            permutation = _permutation(direction, plane)
            if permutation is not None:
                found.append(_symmetry(permutation, plane))
    return found


def images_of(robot: Robot) -> list[Symmetry]:
    """Return the robot's symmetries besides the identity; they are about z."""
    return symmetries(robot.chamber_direction)[1:] if robot.axis in ("+z", "-z") else []


def reflected(samples: Equilibria, operations: list[Symmetry]) -> Equilibria:
    """Return ``samples`` and their images under all ``operations``, operation by operation."""
    images = []
    for g, vector in operations:
        images.append(
            Equilibria(
                samples.load @ g.T,
                samples.coordinate @ g.T,
                samples.energy,
                g @ samples.compliance @ g.T,
                np.einsum("ai,bj,ck,sijk->sabc", g, g, g, samples.compliance_slope, optimize=True),
                g @ samples.stiffness @ g.T,
                g @ samples.mass @ g.T,
                g @ samples.lag_stiffness @ g.T,
                g @ samples.lag_viscosity @ g.T,
                np.linalg.det(vector) * vector @ samples.lag_spin @ g.T,
                samples.centre_of_mass @ vector.T,
                vector @ samples.centre_slope @ g.T,
                vector @ samples.give @ vector.T,
                np.linalg.det(vector) * vector @ samples.give_spin @ vector.T,
                vector @ samples.give_mass @ vector.T,
                vector @ samples.give_coupling @ g.T,
                np.linalg.det(vector) * samples.rotation @ vector.T,
                np.linalg.det(vector) * vector @ samples.rotation_slope @ g.T,
            )
        )
    return Equilibria(*(np.concatenate(column) for column in zip(*images, strict=True)))


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
