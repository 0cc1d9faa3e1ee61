"""The rigid motion that places a simulator's frame in a session's."""

from typing import NamedTuple

import numpy as np


class Registration(NamedTuple):
    """Rigid placement of the simulator's base frame in a session's frame: ``turn @ p + shift``."""

    turn: np.ndarray
    shift: np.ndarray


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
