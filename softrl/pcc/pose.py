"""Where a circle's arc leads, without a loss of digits where it is straight."""

import math

import numpy as np

from softrl.core.compiled import borrowing

SERIES_BELOW = 4.0  # squared bend angle under which nine terms of the series are exact to the last digit


@borrowing
def _remainders(x: float) -> tuple[float, float]:
    """Return ``(f - 1/2) / x`` and ``(F - 1/6) / x`` at ``x = b^2``, see ``shape_functions``."""
    if x < SERIES_BELOW:  # 1 / 4! ... 1 / 20! and 1 / 5! ... 1 / 21!, with alternating signs
        f = 1 / 6402373705728000 - x * (1 / 2432902008176640000)
        f = -1 / 479001600 + x * (1 / 87178291200 + x * (-1 / 20922789888000 + x * f))
        f = -1 / 24 + x * (1 / 720 + x * (-1 / 40320 + x * (1 / 3628800 + x * f)))
        h = 1 / 121645100408832000 - x * (1 / 51090942171709440000)
        h = -1 / 6227020800 + x * (1 / 1307674368000 + x * (-1 / 355687428096000 + x * h))
        h = -1 / 120 + x * (1 / 5040 + x * (-1 / 362880 + x * (1 / 39916800 + x * h)))
        return f, h
    b = math.sqrt(x)
    return ((1.0 - math.cos(b)) / x - 0.5) / x, ((b - math.sin(b)) / (b * x) - 1 / 6) / x


@borrowing
def shape_functions(x: float) -> tuple[float, float, float, float, float, float]:
    """Return f, g, F and their derivatives by the bend angle b, over b, at ``x = b^2``.

    ``f = (1 - cos b) / b^2``, ``g = sin b / b``, ``F = (b - sin b) / b^3``: all are entire functions of
    ``b^2``. With ``f = 1/2 + x u`` and ``F = 1/6 + x v`` the other four follow from u and v without a loss of digits.
    """
    u, v = _remainders(x)
    f, h = 0.5 + x * u, 1 / 6 + x * v
    return f, 1.0 - x * h, h, -2.0 * u - h, h - f, u - 3.0 * v


@borrowing
def tip_pose(body: np.ndarray, length: float, position: np.ndarray, quaternion: np.ndarray) -> None:
    """Fill the tip's position (3,) m and orientation (4,) w x y z of a body bent by ``body`` (3,)."""
    x = body[0] * body[0] + body[1] * body[1]
    u, v = _remainders(x)
    f, g = 0.5 + x * u, 1.0 - x * (1 / 6 + x * v)
    stretched = length * (1.0 + body[2])
    position[0], position[1], position[2] = stretched * f * body[0], stretched * f * body[1], stretched * g
    x *= 0.25
    u, v = _remainders(x)
    half = 0.5 - 0.5 * x * (1 / 6 + x * v)
    quaternion[0] = 1.0 - x * (0.5 + x * u)
    quaternion[1], quaternion[2], quaternion[3] = -half * body[1], half * body[0], 0.0
