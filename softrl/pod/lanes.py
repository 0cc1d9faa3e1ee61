"""Small algebra of many trajectories in step: what ``pod.potential`` does for one, with the lane as last axis."""

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.core.compiled import summing


class Lanes(NamedTuple):
    """What a block of lanes holds during a step, ``r`` coordinates.

    Attributes
    ----------
    mass, stiff, inertia, matrix : (r, r, lanes), the last one scratch
    steep, right, gradient, direction, wanted, trial : (r, lanes)
    points : (r, lanes) in the unit ball;  radius : (lanes,) of the states they belong to
    root : (r r, lanes);  pairs : (r (r + 1) / 2, lanes)
    values : (k, lanes) monomials;  mixed : (k, lanes) polynomials, one a lane
    some : (5, lanes) scratch
    """

    mass: np.ndarray
    stiff: np.ndarray
    inertia: np.ndarray
    matrix: np.ndarray
    steep: np.ndarray
    right: np.ndarray
    gradient: np.ndarray
    direction: np.ndarray
    wanted: np.ndarray
    trial: np.ndarray
    points: np.ndarray
    radius: np.ndarray
    root: np.ndarray
    pairs: np.ndarray
    values: np.ndarray
    mixed: np.ndarray
    some: np.ndarray


@nb.njit(cache=True)
def make_lanes(r: int, lanes: int, tables: Any) -> Lanes:
    """Return room for ``lanes`` lanes."""
    full, one = (r, r, lanes), (r, lanes)
    return Lanes(
        np.zeros(full), np.zeros(full), np.zeros(full), np.zeros(full),
        np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one),
        np.zeros(lanes), np.zeros((r * r, lanes)), np.zeros((r * (r + 1) // 2, lanes)),
        np.zeros((len(tables.parent), lanes)), np.zeros((len(tables.parent), lanes)), np.zeros((5, lanes)),
    )  # fmt: skip


@summing
def add(total: np.ndarray, left: np.ndarray, right: np.ndarray) -> None:
    """Add ``left * right`` to ``total``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] += left[lane] * right[lane]


@summing
def take(total: np.ndarray, left: np.ndarray, right: np.ndarray) -> None:
    """Take ``left * right`` from ``total``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] -= left[lane] * right[lane]


@summing
def add_times(total: np.ndarray, scale: float, right: np.ndarray) -> None:
    """Add ``scale * right`` to ``total``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] += scale * right[lane]


@summing
def add_scaled(total: np.ndarray, scale: float, left: np.ndarray, right: np.ndarray) -> None:
    """Add ``scale * left * right`` to ``total``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] += scale * left[lane] * right[lane]


@summing
def combine(a: float, x: np.ndarray, b: float, y: np.ndarray, c: float, z: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` (lanes,) with a x + b y + c z."""
    for lane in range(len(out)):
        out[lane] = a * x[lane] + b * y[lane] + c * z[lane]


@nb.njit(cache=True)
def fill_monomials(points: np.ndarray, tables: Any, values: np.ndarray) -> None:
    """Fill the monomials ``values`` (k, lanes) at ``points`` (r, lanes)."""
    lanes = points.shape[1]
    values[0] = 1.0
    for k in range(1, len(values)):
        lower, variable = tables.parent[k], tables.variable[k]
        for lane in range(lanes):
            values[k, lane] = values[lower, lane] * points[variable, lane]


@nb.njit(cache=True)
def fill_rows(coefficients: np.ndarray, values: np.ndarray, rows: np.ndarray) -> None:
    """Fill ``rows`` (m, lanes) with the polynomials ``coefficients`` (m, k) at monomials ``values`` (>= k, lanes)."""
    if coefficients.shape[1] > 0:
        np.dot(coefficients, values[: coefficients.shape[1]], rows)
    else:
        rows[:] = 0.0


@nb.njit(cache=True, error_model="numpy")
def to_balls(y: np.ndarray, points: np.ndarray, radius: np.ndarray) -> None:
    """Fill the nearest points (r, lanes) of the unit ball to ``y`` (r, lanes), and their ``radius`` (lanes,)."""
    radius[:] = 0.0
    for i in range(len(y)):
        add(radius, y[i], y[i])
    for lane in range(len(radius)):
        radius[lane] = math.sqrt(radius[lane])
    for i in range(len(y)):
        for lane in range(len(radius)):
            points[i, lane] = y[i, lane] / max(radius[lane], 1.0)


@nb.njit(cache=True)
def fill_squares(root: np.ndarray, squares: np.ndarray) -> None:
    """Fill ``squares`` (r, r, lanes) with R' R of ``root`` (k r, lanes)."""
    r = len(squares)
    for i in range(r):
        for j in range(i, r):
            squares[i, j] = 0.0
            for k in range(len(root) // r):
                add(squares[i, j], root[k * r + i], root[k * r + j])
            squares[j, i] = squares[i, j]


@nb.njit(cache=True)
def squares_of(matrix: np.ndarray, vector: np.ndarray, part: np.ndarray, total: np.ndarray) -> None:
    """Fill ``total`` (lanes,) with vector' matrix vector; ``part`` (lanes,) is scratch."""
    total[:] = 0.0
    for i in range(len(vector)):
        part[:] = 0.0
        for j in range(len(vector)):
            add(part, matrix[i, j], vector[j])
        add(total, part, vector[i])


@nb.njit(cache=True, error_model="numpy")
def scale_down(vector: np.ndarray, energy: np.ndarray, matrix: np.ndarray, some: np.ndarray) -> None:
    """Scale ``vector`` (r, lanes) until its squares in ``matrix`` are no more than ``energy`` (lanes,)."""
    squares_of(matrix, vector, some[0], some[1])
    for lane in range(len(energy)):
        now = some[1, lane]
        if now > energy[lane]:
            share = math.sqrt(energy[lane] / now)
            for i in range(len(vector)):
                vector[i, lane] *= share
