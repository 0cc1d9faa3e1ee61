"""The polynomials of many trajectories in step: tables with a row a monomial, and their products with those of all lanes."""

from typing import Any, NamedTuple

import numpy as np

from softrl.core.compiled import standing
from softrl.pod.lanes.algebra import Lanes, add, add_times, put_times
from softrl.pod.lanes.products import multiply
from softrl.pod.step.potential import Tables


class Columns(NamedTuple):
    """Tables of ``pod.step.potential`` turned, a polynomial in a column; ``levels`` (degrees + 1,) where each degree begins.

    What is mixed by polynomials instead of monomials, the root of viscosity, stands as it is in ``Tables``.
    """

    levels: np.ndarray
    hessian: np.ndarray
    amplitudes: np.ndarray
    amplitude_slope: np.ndarray
    stiffness_root: np.ndarray
    inner_give: np.ndarray
    inner_root: np.ndarray
    drag_root: np.ndarray


def columns_of(tables: Tables) -> Columns:
    """Return the turned tables of ``tables``."""
    levels = np.searchsorted(tables.degrees, np.arange(tables.degrees[-1] + 2.0))
    return Columns(levels, *(np.ascontiguousarray(getattr(tables, name).T) for name in Columns._fields[1:]))


@standing
def fill_monomials(points: np.ndarray, tables: Any, lanes: int, values: np.ndarray) -> None:
    """Fill the monomials ``values`` (k, >= lanes) at the first ``lanes`` of ``points`` (r, >= lanes)."""
    values[0] = 1.0
    for k in range(1, len(values)):
        lower, along = values[tables.parent[k]], points[tables.variable[k]]
        for lane in range(lanes):
            values[k, lane] = lower[lane] * along[lane]


@standing
def fill_rows(table: np.ndarray, values: np.ndarray, rows: np.ndarray) -> None:
    """Fill ``rows`` (m, lanes) with the polynomials ``table`` (k, m) at monomials ``values`` (>= k, lanes)."""
    if len(table) > 0:
        multiply(table, values, 0, len(table), rows.shape[1], rows)
    else:
        rows[:] = 0.0


@standing
def _weight(degree: int, last: bool) -> float:
    """Return by how much the sum of all parts up to ``degree`` counts where a part of degree d counts 1 / (d + 1)."""
    return 1.0 / (degree + 1.0) - (0.0 if last else 1.0 / (degree + 2.0))


@standing
def fill_leads(columns: Columns, held: Lanes, lead: np.ndarray, amplitudes: np.ndarray) -> None:
    """Fill amplitudes (m, lanes) and their gradient ``lead`` (m r, lanes) where the lanes' ``points`` are.

    By Euler's theorem a part of degree d is its gradient times ``points / d``: one product for both.
    """
    r, lanes = held.points.shape
    table, step = columns.amplitude_slope, held.wanted
    for a in range(len(amplitudes)):
        amplitudes[a] = columns.amplitudes[0, a]
    degree, end = 0, 0
    while end < len(table):
        begin, end = end, columns.levels[degree + 1]
        multiply(table, held.values, begin, end, lanes, lead)
        weight = _weight(degree, end == len(table))
        for i in range(r):
            put_times(step[i], weight, held.points[i])
        for a in range(len(amplitudes)):
            for i in range(r):
                add(amplitudes[a], lead[a * r + i], step[i])
        degree += 1


@standing
def fill_curves(tables: Any, columns: Columns, held: Lanes, lanes: int) -> None:
    """Fill the potential's gradient and Hessian, ``pairs``, of the first ``lanes`` where their ``points`` are.

    As ``pod.step.potential.fill_potential``, in the ball: the sums that make the gradient are taken on the way to the Hessian.
    """
    r, pulls, pair = len(held.points), held.pulls, 0
    degree, end = 0, 0
    pulls[:] = 0.0
    while end < len(columns.hessian):
        begin, end = end, columns.levels[degree + 1]
        multiply(columns.hessian, held.values, begin, end, lanes, held.pairs)
        weight = _weight(degree, end == len(columns.hessian))
        for pair in range(len(pulls)):
            add_times(pulls[pair, :lanes], weight, held.pairs[pair])
        degree += 1
    for i in range(r):
        held.gradient[i] = tables.gradient[i, 0]
    pair = 0
    for i in range(r):
        for j in range(i, r):
            add(held.gradient[i, :lanes], pulls[pair], held.points[j])
            if i != j:
                add(held.gradient[j, :lanes], pulls[pair], held.points[i])
            pair += 1
