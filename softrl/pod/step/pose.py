"""Where the reduced body's tip is and how it is turned, compiled."""

import math
from typing import Any

import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.core.compiled import borrowing, summing
from softrl.pod.step.potential import fill_monomials, polynomial, to_ball


@summing
def _spun(coefficients: np.ndarray, values: np.ndarray, degrees: np.ndarray, beyond: float) -> float:
    """Return a polynomial at monomials ``values`` on the sphere, each going on linearly for ``beyond`` radii."""
    total = 0.0
    for m in range(len(coefficients)):
        total += coefficients[m] * values[m] * (1.0 + beyond * degrees[m])
    return total


@borrowing
def tip_pose(
    y: np.ndarray,
    gives: np.ndarray,
    felt: np.ndarray,
    tables: Any,
    values: np.ndarray,
    point: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
) -> None:
    """Fill the tip's position (3,) m and quaternion (4,) w x y z at ``y``.

    ``gives`` (6,) is how far the inside gives beyond what weight makes it give, and ``felt`` (3,) m/s^2 the gravity that acts:
    an effect may have turned it.
    """
    n, r = len(y) - 3, len(y)
    beyond = max(to_ball(y, point) - 1.0, 0.0)
    few = values[: max(tables.rotation.shape[1], tables.turn.shape[1], tables.inner_rotation.shape[1])]
    fill_monomials(point, tables.parent, tables.variable, few)
    square = given = 0.0
    for k in range(3):
        position[k] = tables.rest_tip[k]
        for j in range(r):
            position[k] += tables.frame[n + k, j] * y[j]
        angle = _spun(tables.rotation[k], few, tables.degrees, beyond)
        quaternion[1 + k] = angle
        square += angle * angle
    half = 0.5 * math.sqrt(square)
    factor = 0.5 if half < 1e-9 else math.sin(half) / (2.0 * half)
    quaternion[0] = math.cos(half)
    for k in range(3):
        quaternion[1 + k] *= factor
    w, a, b, c = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    turn = (0.0, 0.0, 0.0)
    for k in range(3):
        angle = 0.5 * polynomial(tables.turn[k], few)
        for axis in range(3):
            tilt = felt[axis] - tables.gravity[axis]
            if tilt != 0.0:
                angle += 0.5 * tilt * polynomial(tables.turn_by_gravity[axis, k], few)
        for j in range(SHAPES):
            angle += 0.5 * polynomial(tables.inner_rotation[k * SHAPES + j], few) * gives[j]
        given += angle * angle
        turn = (turn[1], turn[2], angle)
    v, (x, y_, z) = 1.0 / math.sqrt(1.0 + given), turn
    quaternion[0] = v * (w - x * a - y_ * b - z * c)
    quaternion[1] = v * (a + x * w + y_ * c - z * b)
    quaternion[2] = v * (b + y_ * w + z * a - x * c)
    quaternion[3] = v * (c + z * w + x * b - y_ * a)
