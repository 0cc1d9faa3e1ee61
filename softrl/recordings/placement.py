"""The rigid motion that places a simulator's frame in a session's."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrl.recordings.run import Recording


class Registration(NamedTuple):
    """Rigid placement of the simulator's base frame in a session's frame: ``turn @ p + shift``."""

    turn: np.ndarray
    shift: np.ndarray


def joined(simulated: Sequence[Recording], runs: Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Return the tips (samples, 3) m that are ``simulated`` and those of ``runs``, wherever these were seen."""
    pairs = [(made.position[run.seen], run.position[run.seen]) for made, run in zip(simulated, runs, strict=True)]
    points, seen = zip(*pairs, strict=True)
    return np.concatenate(points), np.concatenate(seen)


def place(points: np.ndarray, seen: np.ndarray) -> Registration:
    """Return the rigid motion that brings ``points`` (steps, 3) closest to ``seen`` (steps, 3).

    Notes
    -----
    Kabsch's solution by singular values, reflections excluded (textbook form, no equation number checked).
    """
    centre, target = points.mean(axis=0), seen.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (seen - target))
    sign = np.sign(np.linalg.det(vt.T @ u.T))
    turn = vt.T @ np.diag([1.0, 1.0, sign]) @ u.T
    return Registration(turn, target - turn @ centre)


def place_nearby(points: np.ndarray, seen: np.ndarray, turn_rad: float, shift_m: float) -> Registration:
    """Return what ``place`` does, but turned by no more than ``turn_rad`` and with the base moved by no more than ``shift_m``."""
    free = Rotation.from_matrix(place(points, seen).turn).as_rotvec()
    turn = Rotation.from_rotvec(free * min(1.0, turn_rad / max(float(np.linalg.norm(free)), 1e-300))).as_matrix()
    shift = seen.mean(axis=0) - turn @ points.mean(axis=0)
    return Registration(turn, shift * min(1.0, shift_m / max(float(np.linalg.norm(shift)), 1e-300)))


def turn_between(simulated: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return the rotation vector (steps, 3) rad from ``simulated`` to ``measured`` quaternions (steps, 4) w x y z."""
    a, b = measured, simulated
    w = np.einsum("ij,ij->i", a, b)
    v = a[:, 1:] * b[:, :1] - b[:, 1:] * a[:, :1] - np.cross(a[:, 1:], b[:, 1:])
    v *= np.where(w < 0.0, -1.0, 1.0)[:, None]
    half = np.linalg.norm(v, axis=1)
    angle = 2.0 * np.arctan2(half, np.abs(w))
    return np.asarray(v * np.where(half > 1e-12, angle / np.maximum(half, 1e-300), 2.0)[:, None])
