"""The squares of many trajectories' steps in viscosity, as ``pod.step.chord`` has them of one: the last axis is the lane."""

from typing import Any

import numpy as np

from softrl.core.compiled import standing
from softrl.pod.lanes.algebra import Lanes, add, add_times, fill_squares, squares_of, take, to_balls
from softrl.pod.lanes.columns import Columns, fill_monomials, fill_rows
from softrl.pod.lanes.insides import fill_drags
from softrl.pod.step.inside import Inside
from softrl.pod.step.viscosity import TINY


@standing
def go_half_way(middle: np.ndarray, tables: Any, columns: Columns, held: Lanes) -> None:
    """Fill the points of ``middle`` (r, lanes) and all monomials there that ``fill_viscosities`` and ``fill_gives`` want."""
    most = max(len(columns.stiffness_root), len(columns.drag_root), len(columns.inner_give))
    to_balls(middle, held.points, held.radius)
    fill_monomials(held.points, tables, middle.shape[1], held.values[:most])


@standing
def fill_viscosities(by: np.ndarray, tables: Any, columns: Columns, insides: Inside, held: Lanes) -> None:
    """Fill viscosities and the forces of their slopes for steps ``by`` (r, lanes), as ``pod.step.viscosity.fill_viscosity``.

    ``go_half_way`` came before.
    """
    driven = held.some[3]
    _fill_chords(by, tables, columns, held, held.stiff, held.steep)
    fill_drags(held.root, columns, held.values, insides)
    driven[:] = 0.0
    for i in range(len(by)):
        take(driven, held.steep[i], by[i])
    squares_of(held.stiff, by, held.some[0], held.some[1])
    for lane in range(by.shape[1]):
        share = max(1.0, driven[lane] / max(held.some[1, lane], TINY))
        for i in range(len(by)):
            held.steep[i, lane] /= share


@standing
def fill_metrics(tables: Any, columns: Columns, held: Lanes, matrix: np.ndarray) -> None:
    """Fill ``matrix`` (r, r, lanes) and ``root``, as ``pod.step.chord.fill_metric``; ``pairs`` are used up."""
    fill_rows(columns.stiffness_root, held.values, held.pairs)
    _fill_roots(tables.stiffness_factor, held)
    fill_squares(held.root, matrix)


@standing
def _fill_chords(by: np.ndarray, tables: Any, columns: Columns, held: Lanes, matrix: np.ndarray, slope: np.ndarray) -> None:
    """Fill ``matrix`` (r, r, lanes) and ``slope`` (r, lanes), as ``pod.step.chord.fill_chord``; ``pairs`` are used up."""
    entries, factor = tables.stiffness_root, tables.stiffness_factor
    fill_metrics(tables, columns, held, matrix)
    _fill_weights(factor, by, held)
    fill_rows(entries, held.pairs, held.mixed[: entries.shape[1]])
    _fill_slopes(entries.shape[1], tables, held, slope)


@standing
def _fill_roots(factor: np.ndarray, held: Lanes) -> None:
    """Fill ``root`` from the entries in ``pairs`` and the lower triangular ``factor``."""
    r, pair = len(factor), 0
    held.root[:] = 0.0
    for a in range(r):
        for c in range(a, r):
            for b in range(c, r):
                add_times(held.root[a * r + b], factor[b, c], held.pairs[pair])
            for b in range(a, r if c > a else a):
                add_times(held.root[c * r + b], factor[b, a], held.pairs[pair])
            pair += 1


@standing
def _fill_weights(factor: np.ndarray, by: np.ndarray, held: Lanes) -> None:
    """Fill ``pairs`` with the derivatives of the squares of ``by`` by the entries of the roots."""
    moved, led = held.gradient, held.wanted
    r, pair = len(by), 0
    for a in range(r):
        moved[a], led[a] = 0.0, 0.0
        for b in range(r):
            add(moved[a], held.root[a * r + b], by[b])
        for b in range(a, r):
            add_times(led[a], 2.0 * factor[b, a], by[b])
    for a in range(r):
        for c in range(a, r):
            held.pairs[pair] = 0.0
            add(held.pairs[pair], moved[a], led[c])
            if c > a:
                add(held.pairs[pair], moved[c], led[a])
            pair += 1


@standing
def _fill_slopes(count: int, tables: Any, held: Lanes, slope: np.ndarray) -> None:
    """Fill ``slope`` with a quarter of the gradients of the first ``count`` monomials weighed by ``mixed``."""
    outward = held.some[2]
    slope[:], outward[:] = 0.0, 0.0
    for k in range(count - 1, 0, -1):
        lower, along = tables.parent[k], tables.variable[k]
        add(slope[along], held.mixed[k], held.values[lower])
        add(held.mixed[lower], held.mixed[k], held.points[along])
    for i in range(len(slope)):
        add(outward, held.points[i], slope[i])
    for i in range(len(slope)):
        for lane in range(len(outward)):
            lost = held.points[i, lane] * outward[lane] if held.radius[lane] > 1.0 else 0.0
            slope[i, lane] = 0.25 * (slope[i, lane] - lost) / max(held.radius[lane], 1.0)
