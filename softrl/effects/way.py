"""What is on its way to a value that is held through a step: how far it gets, and its mean over the step.

With a step of 0 no time passes, and the mean is what there is.
"""

import math

from softrl.core.compiled import borrowing


@borrowing
def share_of_lag(lag_s: float, dt: float) -> float:
    """Return the share of the way to a held value that a first-order lag covers in ``dt``."""
    return 1.0 if lag_s <= 0.0 else -math.expm1(-dt / lag_s)


@borrowing
def bound_of(rate: float, dt: float) -> float:
    """Return how far a rate leads in ``dt``; one without a bound leads anywhere at once."""
    return rate if math.isinf(rate) else rate * dt


@borrowing
def mean_of_lag(goal: float, begin: float, moved: float, lag_s: float, dt: float) -> float:
    """Return the mean of what has ``moved`` from ``begin`` towards ``goal`` with a lag: it lacks ``lag_s`` times its rate."""
    if lag_s <= 0.0:
        return goal
    return goal - lag_s * moved / dt if dt > 0.0 else begin


@borrowing
def mean_of_ramp(begin: float, moved: float, most: float) -> float:
    """Return the mean of what has ``moved`` from ``begin`` as fast as it moves by ``most`` in the step, and then stood."""
    return begin + moved - 0.5 * moved * min(abs(moved) / most, 1.0) if most > 0.0 else begin
