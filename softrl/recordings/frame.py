"""Rotations of recorded poses into the base frame. Quaternions are w x y z."""

import numpy as np
from scipy.spatial.transform import Rotation

WRITTEN = 1e-8  # from the norm of one: what the digits of a file leave


def axis_vector(axis: str) -> np.ndarray:
    """Return the unit vector (3,) of an axis named ``+x`` .. ``-z``."""
    vector = np.zeros(3)
    vector["xyz".index(axis[1])] = -1.0 if axis[0] == "-" else 1.0
    return vector


def rotation_between(axis: str, wanted: str) -> Rotation:
    """Return the shortest rotation of ``axis`` onto ``wanted``; half a turn about x (or y) if opposite."""
    start, end = axis_vector(axis), axis_vector(wanted)
    normal = np.cross(start, end)
    if not normal.any() and start @ end < 0.0:
        normal = np.array([1.0, 0.0, 0.0]) if start[0] == 0.0 else np.array([0.0, 1.0, 0.0])
    return Rotation.from_rotvec(normal * np.arccos(start @ end))


def rotate(rotation: Rotation, vectors: np.ndarray) -> np.ndarray:
    """Return vectors (steps, 3) in the turned frame."""
    return np.asarray(rotation.apply(vectors))


def turn(rotation: Rotation, quaternion: np.ndarray) -> np.ndarray:
    """Return orientations (steps, 4) between two bodies whose frames are both turned: rest stays rest."""
    turned = rotation * Rotation.from_quat(quaternion, scalar_first=True) * rotation.inv()
    return continuous_quaternion(turned.as_quat(scalar_first=True))


def continuous_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Return unit quaternions (steps, 4) without jumps of sign, the first one with w >= 0."""
    norm = np.linalg.norm(quaternion, axis=1, keepdims=True)
    unit = quaternion / np.where(np.abs(norm - 1.0) < WRITTEN, 1.0, norm)  # a file that is read is written as it was
    agree = np.where(np.sum(unit[1:] * unit[:-1], axis=1) < 0.0, -1.0, 1.0)
    first = -1.0 if unit[0, 0] < 0.0 else 1.0
    return np.asarray(unit * (first * np.concatenate([[1.0], np.cumprod(agree)]))[:, None])
