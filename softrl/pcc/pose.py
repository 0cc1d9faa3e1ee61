"""Where a backbone whose curvature changes evenly along it leads, and what loads do to it, without a loss of digits.

The tangent at the share ``s`` of the length leans by the angle ``b s + c (s - s^2)``, a vector of two: ``b`` is the bend of the
tip and ``c`` what the curvature loses from the base to the tip, half of it on either side of ``b``.
"""

import math

import numpy as np

from softrl.core.compiled import borrowing

SERIES_BELOW = 4.0  # squared bend angle under which eight terms of the series are exact to the last digits


@borrowing
def stumpff(x: float) -> tuple[float, float, float, float, float, float, float]:
    """Return Stumpff's functions ``c_2 ... c_8`` at ``x = b^2``: ``c_n`` is the sum over k of ``(-x)^k / (2 k + n)!``.

    ``c_0 = cos b``, ``c_1 = sin b / b`` and ``c_n = 1 / n! - x c_(n + 2)``. The derivative of ``c_n`` by b, over b, is
    ``n c_(n + 2) - c_(n + 1)``, the integral of ``(1 - s)^(n - 1) cos(b s)`` over 0 to 1 is ``(n - 1)! c_n``.
    """
    if x < SERIES_BELOW:  # 1 / 8! ... 1 / 22! and 1 / 7! ... 1 / 21!
        c8 = 1 / 20922789888000 - x * (1 / 6402373705728000 - x * (1 / 2432902008176640000 - x * (1 / 2432902008176640000 / 462)))
        c8 = 1 / 40320 - x * (1 / 3628800 - x * (1 / 479001600 - x * (1 / 87178291200 - x * c8)))
        c7 = 1 / 1307674368000 - x * (1 / 355687428096000 - x * (1 / 121645100408832000 - x * (1 / 51090942171709440000)))
        c7 = 1 / 5040 - x * (1 / 362880 - x * (1 / 39916800 - x * (1 / 6227020800 - x * c7)))
        c6, c5 = 1 / 720 - x * c8, 1 / 120 - x * c7
        c4, c3 = 1 / 24 - x * c6, 1 / 6 - x * c5
        return 0.5 - x * c4, c3, c4, c5, c6, c7, c8
    b, per = math.sqrt(x), 1.0 / x
    c2, c3 = (1.0 - math.cos(b)) * per, (1.0 - math.sin(b) / b) * per
    c4, c5 = (0.5 - c2) * per, (1 / 6 - c3) * per
    c6, c7 = (1 / 24 - c4) * per, (1 / 120 - c5) * per
    return c2, c3, c4, c5, c6, c7, (1 / 720 - c6) * per


@borrowing
def squared_bend(shape: np.ndarray) -> float:
    """Return what Stumpff's functions are taken at for a ``shape`` (5,)."""
    return float(shape[0] * shape[0] + shape[1] * shape[1])


@borrowing
def _tip(shape: np.ndarray, length: float, c: tuple[float, ...], position: np.ndarray) -> None:
    """Fill ``tip_position``; ``c`` are Stumpff's functions at the shape's squared bend."""
    bx, by, cx, cy = shape[0], shape[1], shape[3], shape[4]
    x, both = bx * bx + by * by, bx * cx + by * cy
    c2, c3, c4, c5, _, _, _ = c
    stretched, along_b = length * (1.0 + shape[2]), c2 + (3.0 * c5 - c4) * both
    position[0], position[1] = stretched * (along_b * bx + c3 * cx), stretched * (along_b * by + c3 * cy)
    position[2] = stretched * (1.0 - x * c3 + (2.0 * c4 - c3) * both - (cx * cx + cy * cy) / 60.0)


@borrowing
def _tip_velocity(shape: np.ndarray, length: float, c: tuple[float, ...], rate: np.ndarray, velocity: np.ndarray) -> None:
    """Fill the derivative of ``_tip`` at the ``rate`` of the shape."""
    bx, by, cx, cy = shape[0], shape[1], shape[3], shape[4]
    x, both = bx * bx + by * by, bx * cx + by * cy
    turning = bx * rate[0] + by * rate[1]
    apart = cx * rate[0] + cy * rate[1] + bx * rate[3] + by * rate[4]
    c2, c3, c4, c5, c6, c7, _ = c
    d2, d3, stretched, stretching = 2.0 * c4 - c3, 3.0 * c5 - c4, length * (1.0 + shape[2]), length * rate[2]
    along_b, along_c = c2 + d3 * both, d3 * turning
    faster = (d2 + (15.0 * c7 - 7.0 * c6 + c5) * both) * turning + d3 * apart
    for k in range(2):
        across = faster * shape[k] + along_b * rate[k] + along_c * shape[3 + k] + c3 * rate[3 + k]
        velocity[k] = stretched * across + stretching * (along_b * shape[k] + c3 * shape[3 + k])
    along = (c3 - c2 + (8.0 * c6 - 5.0 * c5 + c4) * both) * turning + d2 * apart - (cx * rate[3] + cy * rate[4]) / 30.0
    velocity[2] = stretched * along + stretching * (1.0 - x * c3 + d2 * both - (cx * cx + cy * cy) / 60.0)


@borrowing
def tip_position(shape: np.ndarray, length: float, position: np.ndarray) -> None:
    """Fill the tip's position (3,) m of the shape ``(b_x, b_y, elongation, c_x, c_y)``.

    To first order in ``c``, and along the axis what its square shortens.
    """
    _tip(shape, length, stumpff(squared_bend(shape)), position)


@borrowing
def tip_motion(
    shape: np.ndarray, length: float, c: tuple[float, ...], rate: np.ndarray, position: np.ndarray, velocity: np.ndarray
) -> None:
    """Fill the tip's position (3,) m and velocity (3,) m/s at the ``rate`` (5,) 1/s of the shape; ``c`` as in ``_tip``."""
    _tip(shape, length, c, position)
    _tip_velocity(shape, length, c, rate, velocity)


@borrowing
def tip_orientation(shape: np.ndarray, quaternion: np.ndarray) -> None:
    """Fill the tip's orientation (4,) w x y z: turned by its bend, about the axis across it."""
    x = 0.25 * (shape[0] * shape[0] + shape[1] * shape[1])
    c2, c3, _, _, _, _, _ = stumpff(x)
    half = 0.5 - 0.5 * x * c3
    quaternion[0], quaternion[1], quaternion[2], quaternion[3] = 1.0 - x * c2, -half * shape[1], half * shape[0], 0.0


@borrowing
def work_of_loads(
    shape: np.ndarray,
    length: float,
    c: tuple[float, ...],
    w0: float,
    w1: float,
    w2: float,
    f0: float,
    f1: float,
    f2: float,
    out: np.ndarray,
) -> None:
    """Fill ``out`` (5,) with the work, J, of the weight ``w`` and a tip force ``f``, N, per change of each number of ``shape``.

    Where the tip is stands in ``tip_position``; the centre of mass is ``stretched`` times ``(c_3 + 2 D c_4 b.c) b + 2 c_4 c``
    across and ``c_2 + 2 D c_3 b.c - c.c / 120`` along the axis, D the derivative by b, over b.
    """
    bx, by, cx, cy = shape[0], shape[1], shape[3], shape[4]
    x, both, square = bx * bx + by * by, bx * cx + by * cy, cx * cx + cy * cy
    c2, c3, c4, c5, c6, c7, c8 = c
    d2, d3, d4 = 2.0 * c4 - c3, 3.0 * c5 - c4, 4.0 * c6 - c5
    dd2, dd3, dd4 = 8.0 * c6 - 5.0 * c5 + c4, 15.0 * c7 - 7.0 * c6 + c5, 24.0 * c8 - 9.0 * c7 + c6
    fb, fc, wb, wc = f0 * bx + f1 * by, f0 * cx + f1 * cy, w0 * bx + w1 * by, w0 * cx + w1 * cy
    stretched = length * (1.0 + shape[2])
    turned = d2 * fb + d3 * fc + dd3 * both * fb + f2 * (c3 - c2 + dd2 * both)
    turned += d3 * wb + 2.0 * (d4 * wc + dd4 * both * wb) + w2 * (d2 + 2.0 * dd3 * both)
    crossed = d3 * fb + d2 * f2 + 2.0 * (d4 * wb + d3 * w2)
    by_tip, by_weight = c2 + d3 * both, c3 + 2.0 * d4 * both
    shorter = -f2 / 30.0 - w2 / 60.0
    out[0] = stretched * (turned * bx + by_tip * f0 + by_weight * w0 + crossed * cx)
    out[1] = stretched * (turned * by + by_tip * f1 + by_weight * w1 + crossed * cy)
    out[3] = stretched * (c3 * f0 + 2.0 * c4 * w0 + crossed * bx + shorter * cx)
    out[4] = stretched * (c3 * f1 + 2.0 * c4 * w1 + crossed * by + shorter * cy)
    along = by_tip * fb + c3 * fc + f2 * (1.0 - x * c3 + d2 * both - square / 60.0)
    along += by_weight * wb + 2.0 * c4 * wc + w2 * (c2 + 2.0 * d3 * both - square / 120.0)
    out[2] = length * along
