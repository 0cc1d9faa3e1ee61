"""How the body's inside gives to its motion, compiled: shapes in which volumes and tip stay, with mass of their own.

``inner`` (2, 6) is how far the inside gives beyond what weight makes it give, and its rate: in units of the acceleration of the
tip, by forces there, whose inertia would make it give, and of the speed, over ``fem.weight.PACE_S``, whose damping would. Its
equations are linear in a step, so that it is eliminated from them: Newton's iteration sees another inertia, and no further
unknowns.
"""

from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.reduced_model import SHAPES, TRIANGLE
from softrl.core.compiled import borrowing
from softrl.pod.step.potential import fill_rows

LEAST = 1e-12  # of a matrix's trace: a smaller pivot is none


class Inside(NamedTuple):
    """What is held of the inside during a step of ``r`` coordinates; scaled by the body's mass as ``mass`` is not.

    Attributes
    ----------
    couple : (r, 6) with the coordinates in the mass;  own : (6, 6) mass
    drag, tough : (r, 6) and (6, 6), likewise in the viscosity
    give : (6, 6) kg s^2, stiffness of the inside
    inverse : (6, 6) of the matrix of a step;  push : (6,) and pull : (r, 6) its right side, and what ties it to the rest
    flown : (6,) where free flight and drag would have it, times the weights of a step, 1/s^2 times the unit of ``inner``
    rows : (6 r + 21,), gives : (21,) scratch
    """

    couple: np.ndarray
    own: np.ndarray
    drag: np.ndarray
    tough: np.ndarray
    give: np.ndarray
    inverse: np.ndarray
    push: np.ndarray
    pull: np.ndarray
    flown: np.ndarray
    rows: np.ndarray
    gives: np.ndarray


@nb.njit(cache=True)
def make_inside(r: int, lanes: tuple[int, ...]) -> Inside:
    """Return the room that ``r`` coordinates need: ``lanes`` is empty, or how many trajectories go in step, the last axis."""
    wide, square, one = (r, SHAPES, *lanes), (SHAPES, SHAPES, *lanes), (SHAPES, *lanes)
    return Inside(
        np.zeros(wide), np.zeros(square), np.zeros(wide), np.zeros(square), np.zeros(square), np.zeros(square),
        np.zeros(one), np.zeros(wide), np.zeros(one), np.zeros((SHAPES * r + TRIANGLE, *lanes)),
        np.zeros((TRIANGLE, *lanes)),
    )  # fmt: skip


@borrowing
def fill_mass(root: np.ndarray, tables: Any, values: np.ndarray, inside: Any) -> None:
    """Fill masses at monomials ``values``; ``root`` (r r,) is that of the coordinates' mass."""
    fill_rows(tables.inner_root, values, inside.rows)
    join(root, inside.rows, inside.couple, inside.own)


@borrowing
def fill_give(tables: Any, values: np.ndarray, inside: Any) -> None:
    """Fill the stiffness at monomials ``values``."""
    fill_rows(tables.inner_give, values, inside.gives)
    fill_own(inside.gives, inside.give)


@borrowing
def fill_drag(root: np.ndarray, tables: Any, values: np.ndarray, inside: Any) -> None:
    """Fill viscosities at monomials ``values``; ``root`` (r r,) is that of the coordinates' viscosity."""
    fill_rows(tables.drag_root, values, inside.rows)
    join(root, inside.rows, inside.drag, inside.tough)


@borrowing
def join(root: np.ndarray, rows: np.ndarray, across: np.ndarray, own: np.ndarray) -> None:
    """Fill ``across`` (r, 6) with R'A and ``own`` (6, 6) with A'A + B'B of ``root`` R and ``rows``, A and the triangle B.

    They and R'R make [R A; 0 B]'[R A; 0 B]: positive wherever the polynomials lead.
    """
    r = len(across)
    for k in range(SHAPES):
        for i in range(r):
            total = 0.0
            for a in range(r):
                total += root[a * r + i] * rows[a * SHAPES + k]
            across[i, k] = total
    fill_own(rows, own)


@borrowing
def fill_own(rows: np.ndarray, matrix: np.ndarray) -> None:
    """Fill ``matrix`` (6, 6) with R'R of ``rows`` (6 k + 21,): k full rows of R, then those of an upper triangle."""
    whole = (len(rows) - TRIANGLE) // SHAPES
    for j in range(SHAPES):
        for k in range(j, SHAPES):
            total = 0.0
            for a in range(whole):
                total += rows[SHAPES * a + j] * rows[SHAPES * a + k]
            first = SHAPES * whole
            for a in range(j + 1):
                total += rows[first + j - a] * rows[first + k - a]
                first += SHAPES - a
            matrix[j, k] = matrix[k, j] = total


@borrowing
def begin_inside(
    inner: np.ndarray, ahead: np.ndarray, start: np.ndarray, dt: float, tables: Any, inside: Any, inertia: np.ndarray,
    right: np.ndarray,
) -> None:
    """Take the inside out of a step: add to ``inertia`` (r, r) and ``right`` (r,) what it leaves there.

    ``ahead`` and ``start`` (r,) are the coordinates after free flight and before the step.
    """
    couple, own, drag, tough, inverse, pull, flown = (
        inside.couple, inside.own, inside.drag, inside.tough, inside.inverse, inside.pull, inside.flown
    )  # fmt: skip
    r, free, rub, late = len(start), tables.scales[0] / dt**2, tables.scales[1] / dt, tables.scales[2] / dt
    for k in range(SHAPES):
        flown[k] = free * (inner[0, k] + dt * inner[1, k]) + rub * inner[0, k]
    for j in range(SHAPES):
        total = 0.0
        for k in range(SHAPES):
            inverse[j, k] = (free + rub) * own[j, k] + late * tough[j, k] + inside.give[j, k]
            total += own[j, k] * flown[k] + late * tough[j, k] * inner[0, k]
        for i in range(r):
            pull[i, j] = (free + rub) * couple[i, j] + late * drag[i, j]
            total += couple[i, j] * (free * ahead[i] + rub * start[i]) + late * drag[i, j] * start[i]
        inside.push[j] = total
    _invert(inverse)
    for i in range(r):
        for k in range(SHAPES):
            share = 0.0
            for j in range(SHAPES):
                share += pull[i, j] * inverse[j, k]
            right[i] += couple[i, k] * flown[k] + late * drag[i, k] * inner[0, k] - share * inside.push[k]
            for j in range(r):
                inertia[i, j] -= share * pull[j, k]


@borrowing
def end_inside(inner: np.ndarray, y: np.ndarray, dt: float, inside: Any) -> float:
    """Bring ``inner`` up to date with the arrival at ``y``; return twice the energy that it stores."""
    left = inside.push
    for k in range(SHAPES):
        for i in range(len(y)):
            left[k] -= inside.pull[i, k] * y[i]
    for j in range(SHAPES):
        total = 0.0
        for k in range(SHAPES):
            total += inside.inverse[j, k] * left[k]
        inner[1, j] = (total - inner[0, j]) / dt
        inner[0, j] = total
    return stored_in(inner[0], inside.give)


@borrowing
def stored_in(vector: np.ndarray, matrix: np.ndarray) -> float:
    """Return vector' matrix vector of the shapes."""
    total = 0.0
    for j in range(SHAPES):
        for k in range(SHAPES):
            total += vector[j] * matrix[j, k] * vector[k]
    return total


@borrowing
def shared_energy(velocity: np.ndarray, inner: np.ndarray, inside: Any) -> float:
    """Return twice the kinetic energy of the inside and of what it shares with the coordinates."""
    total = stored_in(inner[1], inside.own)
    for i in range(len(velocity)):
        for k in range(SHAPES):
            total += 2.0 * velocity[i] * inside.couple[i, k] * inner[1, k]
    return total


@borrowing
def _invert(m: np.ndarray) -> None:
    """Invert a symmetric matrix (k, k) in place, pivot by pivot; what stands beside no pivot has no inverse, and zero for it."""
    size = len(m)
    least = 0.0
    for k in range(size):
        least += LEAST * abs(m[k, k])
    for k in range(size):
        pivot = 1.0 / m[k, k] if m[k, k] > least else 0.0
        for i in range(size):
            if i != k:
                share = pivot * m[i, k]
                for j in range(size):
                    if j != k:
                        m[i, j] -= share * m[k, j]
        for i in range(size):
            m[i, k] *= pivot
            m[k, i] = m[i, k]
        m[k, k] = -pivot
    for i in range(size):
        for j in range(size):
            m[i, j] = -m[i, j]
