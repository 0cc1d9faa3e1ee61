"""Quaternions w x y z in compiled code."""

import numpy as np

from softrl.core.compiled import borrowing


@borrowing
def product(a: float, b: float, c: float, d: float, turn: np.ndarray) -> tuple[float, float, float, float]:
    """Return the quaternion a, b, c, d times ``turn`` (4,)."""
    e, f, g, h = turn[0], turn[1], turn[2], turn[3]
    w, x = a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g
    return w, x, a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e
