"""What the last two steps tell of the next one, compiled: where it is likely to lead, before the potential is asked there.

By their tangents a step is foretold to third order in its length, so that its own first iteration of Newton's method, from
there, nearly always ends it.
"""

from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.core.compiled import borrowing


class Past(NamedTuple):
    """Derivatives of the last steps, r coordinates.

    Attributes
    ----------
    seen : (r,) where the potential was asked last;  slope : (r,), curve : (r, r) its derivatives there, J
    curve_before : (r, r) a step earlier
    """

    seen: np.ndarray
    slope: np.ndarray
    curve: np.ndarray
    curve_before: np.ndarray


@nb.njit(cache=True)
def make_past(r: int) -> Past:
    """Return room for ``r`` coordinates."""
    return Past(np.zeros(r), np.zeros(r), np.zeros((r, r)), np.zeros((r, r)))


@borrowing
def keep(past: Any, y: np.ndarray, gradient: np.ndarray, hessian: np.ndarray) -> None:
    """Keep the potential's derivatives at ``y``."""
    for i in range(len(y)):
        past.seen[i], past.slope[i] = y[i], gradient[i]
        for j in range(len(y)):
            past.curve[i, j] = hessian[i, j]


@borrowing
def foretell_potential(past: Any, y: np.ndarray, gradient: np.ndarray, hessian: np.ndarray) -> None:
    """Fill the potential's derivatives (r,) and (r, r) that are likely at ``y``, a step from where it was asked last.

    Asked once a step: the last curve is then that of a step earlier.
    """
    r = len(y)
    for i in range(r):
        gradient[i] = past.slope[i]
        for j in range(r):
            change = past.curve[i, j] - past.curve_before[i, j]
            hessian[i, j] = past.curve[i, j] + change
            gradient[i] += (past.curve[i, j] + 0.5 * change) * (y[j] - past.seen[j])
            past.curve_before[i, j] = past.curve[i, j]
