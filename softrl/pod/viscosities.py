"""What the time steps of many trajectories resist, as ``pod.viscosity``: the last axis of every array is the lane."""

from typing import Any

import numba as nb
import numpy as np

from softrl.pod.inside import Inside
from softrl.pod.insides import fill_drags
from softrl.pod.lanes import (
    Lanes,
    add,
    fill_ahead,
    fill_behind,
    fill_factor,
    fill_monomials,
    fill_rows,
    fill_squares,
    fill_tangent,
    squares_of,
    take,
)
from softrl.pod.potential import diagonal
from softrl.pod.viscosity import HELD, TINY


@nb.njit(cache=True, error_model="numpy")
def fill_viscosities(start: np.ndarray, by: np.ndarray, tables: Any, insides: Inside, held: Lanes) -> None:
    """Fill viscosity, the insides', and the forces of its slope half way of steps ``by`` (r, lanes), as ``pod.viscosity``."""
    steep, driven, outward = held.steep, held.some[3], held.some[2]
    wide = max(len(held.mixed), tables.drag_root.shape[1])
    fill_ahead(start, by, 0.5, held)
    fill_monomials(held.points, tables, held.values[:wide])
    fill_rows(tables.elastic, held.values, held.pairs)
    fill_rows(tables.stiffness_root, held.values, held.root)
    fill_factor(held.pairs, tables.elastic[:, 0], held.matrix, held.some)
    fill_behind(held.root, held.matrix, held.product)
    fill_squares(held.product, held.stiff)
    fill_drags(held.product, tables, held.values, insides)
    _fill_slopes_behind(by, held)
    _fill_slopes(tables, held)
    outward[:], driven[:] = 0.0, 0.0
    for i in range(len(by)):
        add(outward, held.points[i], steep[i])
    fill_tangent(steep, outward, held, held.trial)
    for i in range(len(by)):
        for lane in range(by.shape[1]):
            steep[i, lane] = 0.25 * held.trial[i, lane]
        take(driven, steep[i], by[i])
    squares_of(held.stiff, by, held.some[0], held.some[1])
    for lane in range(by.shape[1]):
        share = max(1.0, driven[lane] / max(held.some[1, lane], TINY))
        for i in range(len(by)):
            steep[i, lane] /= share


@nb.njit(cache=True, error_model="numpy")
def _fill_slopes_behind(by: np.ndarray, held: Lanes) -> None:
    """Fill how ``|R U' by|^2`` changes with the roots R and with the elastic Hessians, as ``pod.viscosity.fill_slope_behind``.

    R and U are in ``root`` and ``matrix``, the Hessians in ``pairs``; what they change by takes the place of ``root`` and
    ``pairs``.
    """
    behind, moved, back = held.wanted, held.gradient, held.direction
    root, factor = held.root, held.matrix
    r, lanes = by.shape
    for j in range(r):
        behind[j], back[j], moved[j] = 0.0, 0.0, 0.0
        for i in range(j + 1):
            add(behind[j], factor[i, j], by[i])
    for a in range(r):
        for b in range(r):
            add(moved[a], root[a * r + b], behind[b])
    for a in range(r):
        for b in range(r):
            add(back[b], moved[a], root[a * r + b])
            for lane in range(lanes):
                root[a * r + b, lane] = 2.0 * moved[a, lane] * behind[b, lane]
    back *= 2.0
    _unfactor(by, back, held)


@nb.njit(cache=True, error_model="numpy")
def _unfactor(by: np.ndarray, back: np.ndarray, held: Lanes) -> None:
    """Fill ``pairs`` with derivatives by the Hessians of what has those ``by`` x ``back`` by their factors."""
    factor, slope, whole, share = held.matrix, held.inertia, held.some[0], held.some[1]
    r, lanes = by.shape
    whole[:] = 1.0
    for i in range(r):
        share[:] = 0.0
        for j in range(i, r):
            add(share, factor[i, j], factor[i, j])
            for lane in range(lanes):
                slope[i, j, lane] = by[i, lane] * back[j, lane]
        for lane in range(lanes):
            if share[lane] > held.pairs[diagonal(i, r), lane] * (1.0 + HELD):
                whole[lane] = 0.0
    for j in range(r):
        for i in range(j + 1):
            for lane in range(lanes):
                share[lane] = slope[i, j, lane] / factor[j, j, lane] * (0.5 if i == j else 1.0)
                held.pairs[diagonal(i, r) + j - i, lane] = whole[lane] * share[lane]
            if i == j:
                share *= 2.0
            else:
                take(slope[j, j], share, factor[i, j])
            for k in range(j + 1, r):
                take(slope[i, k], share, factor[j, k])
                if i < j:
                    take(slope[j, k], share, factor[i, k])


@nb.njit(cache=True)
def _fill_slopes(tables: Any, held: Lanes) -> None:
    """Fill ``steep`` with gradients at ``points`` of the roots and elastic Hessians, weighed by ``root`` and ``pairs``."""
    mixed, values = held.mixed, held.values
    mixed[:] = 0.0
    mixed[: tables.stiffness_root.shape[1]] += np.dot(tables.stiffness_root.T, held.root)
    mixed[: tables.elastic.shape[1]] += np.dot(tables.elastic.T, held.pairs)
    held.steep[:] = 0.0
    for k in range(len(mixed) - 1, 0, -1):
        lower, along = tables.parent[k], tables.variable[k]
        add(held.steep[along], mixed[k], values[lower])
        add(mixed[lower], mixed[k], held.points[along])
