"""The free motion of a second-order law over a time step, exact whether it rings or creeps."""

import math

from softrl.core.compiled import borrowing


@borrowing
def free_motion(decay: float, square: float, dt: float) -> tuple[float, float]:
    """Return ``exp(-decay t) cosh(w t)`` and ``exp(-decay t) sinh(w t) / w`` after ``dt``, where ``w^2 = square`` of either sign.

    They solve ``x'' + 2 decay x' + (decay^2 - square) x = 0``: ``x = even x_0 + odd (x'_0 + decay x_0)``.
    """
    turn = math.sqrt(abs(square))
    if square > 0.0:
        slow, fast = math.exp((turn - decay) * dt), math.exp(-(turn + decay) * dt)
        return 0.5 * (slow + fast), 0.5 * (slow - fast) / turn
    even, odd = math.exp(-decay * dt) * math.cos(turn * dt), math.exp(-decay * dt) * dt
    if turn * dt > 1e-8:
        odd *= math.sin(turn * dt) / (turn * dt)
    return even, odd
