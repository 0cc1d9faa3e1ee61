"""What a time step resists: the change of strain from its start to its end, compiled.

The full model resists that change, not its rate at some moment. Half its square is ``by' D by / 2`` for a step ``by``, D the
viscosity half way, to third order; the derivative by the arrival is ``D by`` and a quarter of the gradient of that square.
"""

from typing import Any

import numba as nb
import numpy as np

from softrl.pod.inside import fill_drag
from softrl.pod.potential import (
    FAST,
    diagonal,
    fill_behind,
    fill_elastic_factor,
    fill_monomials,
    fill_rows,
    fill_square,
    square_of,
    to_ball,
)

HELD = 1e-9  # of a diagonal: a factor whose row's square is larger has its pivot held
TINY = 1e-300


@nb.njit(cache=True)
def fill_viscosity(start: np.ndarray, by: np.ndarray, tables: Any, work: Any, held: Any) -> None:
    """Fill viscosity and the inside's half way of a step from ``start`` by ``by`` (r,), and the force of its slope.

    The force is never more than would turn what damps into what drives. ``work`` and ``held`` are those of ``pod.kernel``.
    """
    values, point, scratch, factor, middle, root, slope, elastic, mixed = work
    _, stiff, _, steep, inside = held
    r = len(by)
    product, turned = slope[: r * r], slope[r * r : 2 * r * r]
    for i in range(r):
        middle[i] = start[i] + 0.5 * by[i]
    radius = to_ball(middle, point)
    few = values[: max(len(mixed), tables.drag_root.shape[1])]
    fill_monomials(point, tables.parent, tables.variable, few)
    fill_rows(tables.elastic, few, elastic)
    fill_rows(tables.stiffness_root, few, root)
    fill_elastic_factor(elastic, tables.elastic[:, 0], factor)
    fill_behind(root, factor, product)
    fill_square(product, stiff)
    fill_drag(product, tables, few, inside)
    bent = np.empty(len(elastic))
    fill_slope_behind(root, factor, elastic, by, scratch, turned, bent)
    mixed[:] = 0.0
    add_mixture(tables.stiffness_root, turned, mixed)
    add_mixture(tables.elastic, bent, mixed)
    fill_slope(mixed, few, point, tables.parent, tables.variable, steep)
    outward = driven = 0.0
    for i in range(r):
        outward += point[i] * steep[i] if radius > 1.0 else 0.0
    for i in range(r):
        steep[i] = 0.25 * (steep[i] - point[i] * outward) / max(radius, 1.0)
        driven -= steep[i] * by[i]
    share = driven / max(square_of(stiff, by), TINY)
    if share > 1.0:
        for i in range(r):
            steep[i] /= share


@nb.njit(cache=True, fastmath=FAST)
def fill_slope_behind(
    root: np.ndarray, factor: np.ndarray, hessian: np.ndarray, along: np.ndarray, scratch: np.ndarray, turned: np.ndarray,
    bent: np.ndarray,
) -> None:
    """Fill how ``|R U' along|^2`` changes with R, ``turned`` (r r,), and with what U was made of, ``bent`` (pairs,).

    ``root`` (r r,) is R row by row, ``factor`` U of ``hessian`` (pairs,), ``scratch`` (r, r). Where a pivot of U is held
    U counts as constant.
    """
    r = len(factor)
    behind, moved, back = scratch[0], scratch[1], scratch[2]
    for j in range(r):
        behind[j] = 0.0
        for i in range(j + 1):
            behind[j] += factor[i, j] * along[i]
    for a in range(r):
        moved[a] = 0.0
        for b in range(r):
            moved[a] += root[a * r + b] * behind[b]
    for b in range(r):
        back[b] = 0.0
        for a in range(r):
            turned[a * r + b] = 2.0 * moved[a] * behind[b]
            back[b] += 2.0 * moved[a] * root[a * r + b]
    _fill_unfactored(factor, hessian, along, back, bent)


@nb.njit(cache=True)
def _fill_unfactored(factor: np.ndarray, hessian: np.ndarray, along: np.ndarray, back: np.ndarray, bent: np.ndarray) -> None:
    """Fill the derivatives ``bent`` (pairs,) by the Hessian of what has those ``along`` x ``back`` by its factor U.

    The elimination of ``fill_elastic_factor`` backwards.
    """
    r = len(factor)
    slope = np.empty((r, r))
    for i in range(r):
        square = 0.0
        for j in range(i, r):
            slope[i, j] = along[i] * back[j]
            square += factor[i, j] * factor[i, j]
        if square > hessian[diagonal(i, r)] * (1.0 + HELD):  # a pivot is held: the factor is none of the Hessian
            bent[:] = 0.0
            return
    for j in range(r):
        for i in range(j):
            share = slope[i, j] / factor[j, j]
            bent[diagonal(i, r) + j - i] = share
            slope[j, j] -= share * factor[i, j]
            for k in range(j + 1, r):
                slope[i, k] -= share * factor[j, k]
                slope[j, k] -= share * factor[i, k]
        share = slope[j, j] / (2.0 * factor[j, j])
        bent[diagonal(j, r)] = share
        for k in range(j + 1, r):
            slope[j, k] -= 2.0 * share * factor[j, k]


@nb.njit(cache=True, fastmath=FAST)
def add_mixture(coefficients: np.ndarray, weights: np.ndarray, mixed: np.ndarray) -> None:
    """Add to ``mixed`` (k,) the polynomials ``coefficients`` (m, k), weighed by ``weights`` (m,)."""
    for m in range(len(weights)):
        weight = weights[m]
        for k in range(coefficients.shape[1]):
            mixed[k] += weight * coefficients[m, k]


@nb.njit(cache=True)
def fill_slope(
    mixed: np.ndarray, values: np.ndarray, point: np.ndarray, parent: np.ndarray, variable: np.ndarray, slope: np.ndarray
) -> None:
    """Fill the gradient ``slope`` (r,) at ``point`` of the polynomial ``mixed`` (k,), which is used up."""
    slope[:] = 0.0
    for k in range(len(mixed) - 1, 0, -1):
        lower, along = parent[k], variable[k]
        slope[along] += mixed[k] * values[lower]
        mixed[lower] += mixed[k] * point[along]
