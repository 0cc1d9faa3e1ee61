"""Small algebra of many trajectories in step: what ``pod.potential`` does for one, with the lane as last axis."""

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.pod.potential import FAST, PIVOT, diagonal


class Lanes(NamedTuple):
    """What a block of lanes holds during a step, ``r`` coordinates.

    Attributes
    ----------
    mass, stiff, inertia, matrix : (r, r, lanes), the last one scratch
    turning, steep, right, gradient, direction, wanted, trial : (r, lanes)
    points : (r, lanes) in the unit ball;  radius : (lanes,) of the states they belong to
    root, product : (r r, lanes);  slope : (r r r, lanes);  pairs : (r (r + 1) / 2, lanes)
    values : (k, lanes) monomials;  mixed : (k, lanes) polynomials, one a lane
    some : (5, lanes) scratch
    """

    mass: np.ndarray
    stiff: np.ndarray
    inertia: np.ndarray
    matrix: np.ndarray
    turning: np.ndarray
    steep: np.ndarray
    right: np.ndarray
    gradient: np.ndarray
    direction: np.ndarray
    wanted: np.ndarray
    trial: np.ndarray
    points: np.ndarray
    radius: np.ndarray
    root: np.ndarray
    product: np.ndarray
    slope: np.ndarray
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
        np.zeros(one), np.zeros(lanes),
        np.zeros((r * r, lanes)), np.zeros((r * r, lanes)), np.zeros((r**3, lanes)),
        np.zeros((r * (r + 1) // 2, lanes)), np.zeros((len(tables.parent), lanes)),
        np.zeros((max(tables.elastic.shape[1], tables.stiffness_root.shape[1]), lanes)), np.zeros((5, lanes)),
    )  # fmt: skip


@nb.njit(cache=True, fastmath=FAST)
def add(total: np.ndarray, left: np.ndarray, right: np.ndarray) -> None:
    """Add ``left * right`` to ``total``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] += left[lane] * right[lane]


@nb.njit(cache=True, fastmath=FAST)
def take(total: np.ndarray, left: np.ndarray, right: np.ndarray) -> None:
    """Take ``left * right`` from ``total``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] -= left[lane] * right[lane]


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
def fill_ahead(y: np.ndarray, velocity: np.ndarray, dt: float, held: Lanes) -> None:
    """Fill ``points`` and ``radius`` of where ``y`` (r, lanes) is ``dt`` later if nothing turns it."""
    for i in range(len(y)):
        for lane in range(y.shape[1]):
            held.trial[i, lane] = y[i, lane] + dt * velocity[i, lane]
    to_balls(held.trial, held.points, held.radius)


@nb.njit(cache=True)
def fill_squares(root: np.ndarray, squares: np.ndarray) -> None:
    """Fill ``squares`` (r, r, lanes) with R' R of ``root`` (r r, lanes)."""
    r = len(squares)
    for i in range(r):
        for j in range(i, r):
            squares[i, j] = 0.0
            for k in range(r):
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


@nb.njit(cache=True, error_model="numpy")
def fill_tangent(vector: np.ndarray, outward: np.ndarray, held: Lanes, along: np.ndarray) -> None:
    """Fill ``along`` (r, lanes) with the motion of the points as the states move by ``vector``, of which ``outward``."""
    for i in range(len(vector)):
        for lane in range(len(outward)):
            beyond = held.radius[lane] > 1.0
            lost = held.points[i, lane] * outward[lane] if beyond else 0.0
            along[i, lane] = (vector[i, lane] - lost) / max(held.radius[lane], 1.0)


@nb.njit(cache=True, error_model="numpy")
def fill_factor(elastic: np.ndarray, rest: np.ndarray, factor: np.ndarray, some: np.ndarray) -> None:
    """Fill ``factor`` (r, r, lanes) from ``elastic`` (pairs, lanes), as ``pod.potential.fill_elastic_factor``."""
    r, lanes = len(factor), factor.shape[2]
    pivot, least = some[0], some[1]
    pair = 0
    for i in range(r):
        for j in range(i, r):
            factor[i, j] = elastic[pair]
            pair += 1
    for j in range(r - 1, -1, -1):
        least[:] = PIVOT * rest[diagonal(j, r)]
        pivot[:] = factor[j, j]
        for k in range(j + 1, r):
            take(pivot, factor[j, k], factor[j, k])
        for i in range(j):
            for k in range(j + 1, r):
                take(factor[i, j], factor[i, k], factor[j, k])
            row = diagonal(i, r)
            for lane in range(lanes):
                entry = factor[i, j, lane]
                least[lane] = max(least[lane], entry * entry / max(elastic[row, lane], rest[row]))
        for lane in range(lanes):
            factor[j, j, lane] = math.sqrt(max(pivot[lane], least[lane]))
        for i in range(j):
            for lane in range(lanes):
                factor[i, j, lane] /= factor[j, j, lane]


@nb.njit(cache=True)
def fill_behind(root: np.ndarray, factor: np.ndarray, product: np.ndarray) -> None:
    """Fill ``product`` (r r, lanes) with R U' of ``root`` (r r, lanes) and ``factor`` (r, r, lanes)."""
    r = len(factor)
    for i in range(r):
        for j in range(r):
            product[i * r + j] = 0.0
            for k in range(j, r):
                add(product[i * r + j], root[i * r + k], factor[j, k])
