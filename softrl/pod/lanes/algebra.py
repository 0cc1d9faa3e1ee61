"""Small algebra of many trajectories in step: what ``pod.step.potential`` does for one, with the lane as last axis."""

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.core.compiled import borrowing, standing, summing
from softrl.pod.step.potential import Room, make_room


class Lanes(NamedTuple):
    """What a block of lanes holds during a step, ``r`` coordinates.

    Attributes
    ----------
    mass, stiff, inertia, matrix : (r, r, lanes), the last one scratch
    steep, right, gradient, direction, wanted, trial, moving, middle, former : (r, lanes);  formerly : (6, lanes)
    points : (r, lanes) in the unit ball;  radius : (lanes,) of the states they belong to
    root : (r r, lanes);  pairs, pulls : (r (r + 1) / 2, lanes)
    values : (k, lanes) monomials;  mixed : (k, lanes) polynomials, one a lane
    order : (lanes,) which of them Newton's iteration still moves;  progress : (lanes, 2) as in ``pod.step.kernel.iterate``
    some : (5, lanes) scratch;  room, and alone (2 r + 2, r), that of a lane which goes alone
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
    moving: np.ndarray
    middle: np.ndarray
    former: np.ndarray
    formerly: np.ndarray
    points: np.ndarray
    radius: np.ndarray
    root: np.ndarray
    pairs: np.ndarray
    pulls: np.ndarray
    values: np.ndarray
    mixed: np.ndarray
    order: np.ndarray
    progress: np.ndarray
    some: np.ndarray
    room: Room
    alone: np.ndarray


@nb.njit(cache=True)
def make_lanes(r: int, lanes: int, tables: Any) -> Lanes:
    """Return room for ``lanes`` lanes."""
    full, one, pairs, many = (r, r, lanes), (r, lanes), (r * (r + 1) // 2, lanes), (len(tables.parent), lanes)
    return Lanes(
        np.zeros(full), np.zeros(full), np.zeros(full), np.zeros(full),
        np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(one),
        np.zeros(one), np.zeros(one), np.zeros((SHAPES, lanes)), np.zeros(one), np.zeros(lanes),
        np.zeros((r * r, lanes)), np.zeros(pairs), np.zeros(pairs), np.zeros(many), np.zeros(many),
        np.zeros(lanes, dtype=np.int64), np.zeros((lanes, 2)), np.zeros((5, lanes)),
        make_room(tables), np.zeros((2 * r + 2, r)),
    )  # fmt: skip


@summing
def add(total: np.ndarray, left: np.ndarray, right: np.ndarray) -> None:
    """Add ``left * right`` to ``total``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] += left[lane] * right[lane]


@summing
def put(total: np.ndarray, right: np.ndarray) -> None:
    """Fill ``total`` with ``right``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] = right[lane]


@summing
def put_rate(total: np.ndarray, after: np.ndarray, before: np.ndarray, dt: float) -> None:
    """Fill ``total`` with ``(after - before) / dt``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] = (after[lane] - before[lane]) / dt


@summing
def put_sum(total: np.ndarray, left: np.ndarray, factor: float, right: np.ndarray) -> None:
    """Fill ``total`` with ``left + factor * right``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] = left[lane] + factor * right[lane]


@summing
def put_times(total: np.ndarray, factor: float, right: np.ndarray) -> None:
    """Fill ``total`` with ``factor * right``, (lanes,) each."""
    for lane in range(len(total)):
        total[lane] = factor * right[lane]


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


@borrowing
def largest(values: np.ndarray) -> float:
    """Return the largest of ``values`` (lanes,), none of which is negative."""
    most = 0.0
    for lane in range(len(values)):
        most = max(most, values[lane])
    return most


@standing
def to_balls(y: np.ndarray, points: np.ndarray, radius: np.ndarray) -> None:
    """Fill the nearest points (r, >= lanes) of the unit ball to ``y`` (r, >= lanes), and their ``radius`` (lanes,)."""
    radius[:] = 0.0
    for i in range(len(y)):
        add(radius, y[i], y[i])
    for lane in range(len(radius)):
        radius[lane] = math.sqrt(radius[lane])
    for i in range(len(y)):
        for lane in range(len(radius)):
            points[i, lane] = y[i, lane] / max(radius[lane], 1.0)


@standing
def fill_squares(root: np.ndarray, squares: np.ndarray) -> None:
    """Fill ``squares`` (r, r, lanes) with R' R of ``root`` (k r, lanes)."""
    r = len(squares)
    for i in range(r):
        for j in range(i, r):
            squares[i, j] = 0.0
            for k in range(len(root) // r):
                add(squares[i, j], root[k * r + i], root[k * r + j])
            put(squares[j, i], squares[i, j])


@standing
def squares_of(matrix: np.ndarray, vector: np.ndarray, part: np.ndarray, total: np.ndarray) -> None:
    """Fill ``total`` (lanes,) with vector' matrix vector; ``part`` (lanes,) is scratch."""
    total[:] = 0.0
    for i in range(len(vector)):
        part[:] = 0.0
        for j in range(len(vector)):
            add(part, matrix[i, j], vector[j])
        add(total, part, vector[i])


@standing
def scale_down(vector: np.ndarray, energy: np.ndarray, matrix: np.ndarray, some: np.ndarray) -> None:
    """Scale ``vector`` (r, lanes) until its squares in ``matrix`` are no more than ``energy`` (lanes,)."""
    squares_of(matrix, vector, some[0], some[1])
    for lane in range(len(energy)):
        now = some[1, lane]
        if now > energy[lane]:
            share = math.sqrt(energy[lane] / now)
            for i in range(len(vector)):
                vector[i, lane] *= share
