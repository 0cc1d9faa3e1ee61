"""The insides of many trajectories in step, as ``pod.step.inside``: the last axis of every array is the lane."""

from typing import Any

import numpy as np

from softrl.artifacts.reduced_model import SHAPES, TRIANGLE
from softrl.core.compiled import standing, summing
from softrl.pod.lanes.algebra import add, add_scaled, put, squares_of, take
from softrl.pod.lanes.columns import fill_rows
from softrl.pod.step.inside import LEAST


@standing
def fill_masses(root: np.ndarray, columns: Any, values: np.ndarray, insides: Any) -> None:
    """Fill masses at monomials ``values`` (k, lanes); ``root`` (r r, lanes) are those of the coordinates' masses."""
    fill_rows(columns.inner_root, values, insides.rows)
    _join(root, insides.rows, insides.couple, insides.own)


@standing
def fill_gives(columns: Any, values: np.ndarray, insides: Any) -> None:
    """Fill the stiffnesses at monomials ``values``."""
    fill_rows(columns.inner_give, values, insides.gives)
    _fill_own(insides.gives, insides.give)


@standing
def fill_drags(root: np.ndarray, columns: Any, values: np.ndarray, insides: Any) -> None:
    """Fill viscosities at monomials ``values``; ``root`` are those of the coordinates' viscosities."""
    fill_rows(columns.drag_root, values, insides.rows)
    _join(root, insides.rows, insides.drag, insides.tough)


@standing
def _join(root: np.ndarray, rows: np.ndarray, across: np.ndarray, own: np.ndarray) -> None:
    r = len(across)
    for i in range(r):
        for k in range(SHAPES):
            across[i, k] = 0.0
            for a in range(r):
                add(across[i, k], root[a * r + i], rows[a * SHAPES + k])
    _fill_own(rows, own)


@standing
def _fill_own(rows: np.ndarray, matrix: np.ndarray) -> None:
    whole = (len(rows) - TRIANGLE) // SHAPES
    for j in range(SHAPES):
        for k in range(j, SHAPES):
            matrix[j, k] = 0.0
            for a in range(whole):
                add(matrix[j, k], rows[SHAPES * a + j], rows[SHAPES * a + k])
            first = SHAPES * whole
            for a in range(j + 1):
                add(matrix[j, k], rows[first + j - a], rows[first + k - a])
                first += SHAPES - a
            put(matrix[k, j], matrix[j, k])


@summing
def _blend(left: np.ndarray, a: float, right: np.ndarray, b: float, out: np.ndarray) -> None:
    """Fill ``out`` (lanes,) with a left + b right."""
    for lane in range(len(out)):
        out[lane] = a * left[lane] + b * right[lane]


@standing
def begin_insides(
    inner: np.ndarray, ahead: np.ndarray, start: np.ndarray, dt: float, tables: Any, insides: Any, scratch: np.ndarray,
    inertia: np.ndarray, right: np.ndarray,
) -> None:
    """Take the insides out of a step as ``pod.step.inside.begin_inside``; ``scratch`` (r, lanes)."""
    couple, drag, inverse, push, pull, flown = (
        insides.couple, insides.drag, insides.inverse, insides.push, insides.pull, insides.flown
    )  # fmt: skip
    r, free, rub, late = len(start), tables.scales[0] / dt**2, tables.scales[1] / dt, tables.scales[2] / dt
    share = insides.rows[0]
    for k in range(SHAPES):
        _blend(inner[0, k], free + rub, inner[1, k], free * dt, flown[k])
    for i in range(r):
        _blend(ahead[i], free, start[i], rub, scratch[i])
    for j in range(SHAPES):
        push[j] = 0.0
        for k in range(SHAPES):
            _blend(insides.own[j, k], free + rub, insides.tough[j, k], late, inverse[j, k])
            _blend(inverse[j, k], 1.0, insides.give[j, k], 1.0, inverse[j, k])
            add(push[j], insides.own[j, k], flown[k])
            add_scaled(push[j], late, insides.tough[j, k], inner[0, k])
        for i in range(r):
            _blend(couple[i, j], free + rub, drag[i, j], late, pull[i, j])
            add(push[j], couple[i, j], scratch[i])
            add_scaled(push[j], late, drag[i, j], start[i])
    _invert(inverse, insides.rows[0], insides.rows[1], insides.rows[2])
    for i in range(r):
        for k in range(SHAPES):
            share[:] = 0.0
            for j in range(SHAPES):
                add(share, pull[i, j], inverse[j, k])
            add(right[i], couple[i, k], flown[k])
            add_scaled(right[i], late, drag[i, k], inner[0, k])
            take(right[i], share, push[k])
            for j in range(r):
                take(inertia[i, j], share, pull[j, k])


@standing
def end_insides(inner: np.ndarray, y: np.ndarray, dt: float, insides: Any, part: np.ndarray, bent: np.ndarray) -> None:
    """Bring ``inner`` (2, 6, lanes) up to date with the arrivals at ``y``; fill twice the energies it stores, ``bent``."""
    left, given = insides.push, insides.rows
    for k in range(SHAPES):
        for i in range(len(y)):
            take(left[k], insides.pull[i, k], y[i])
    for j in range(SHAPES):
        given[j] = 0.0
        for k in range(SHAPES):
            add(given[j], insides.inverse[j, k], left[k])
        _blend(given[j], 1.0 / dt, inner[0, j], -1.0 / dt, inner[1, j])
        put(inner[0, j], given[j])
    squares_of(insides.give, inner[0], part, bent)


@standing
def shared_energies(velocity: np.ndarray, inner: np.ndarray, insides: Any, part: np.ndarray, total: np.ndarray) -> None:
    """Fill ``total`` (lanes,) with twice the kinetic energies of the insides and of what they share; ``part`` is scratch."""
    squares_of(insides.own, inner[1], part, total)
    for i in range(len(velocity)):
        part[:] = 0.0
        for k in range(SHAPES):
            add_scaled(part, 2.0, insides.couple[i, k], inner[1, k])
        add(total, part, velocity[i])


@standing
def _invert(m: np.ndarray, least: np.ndarray, pivot: np.ndarray, share: np.ndarray) -> None:
    """Invert symmetric matrices (k, k, lanes) in place, as ``pod.step.inside`` does; the other three are scratch (lanes,)."""
    size, lanes = len(m), m.shape[2]
    least[:] = 0.0
    for k in range(size):
        for lane in range(lanes):
            least[lane] += LEAST * abs(m[k, k, lane])
    for k in range(size):
        for lane in range(lanes):
            pivot[lane] = 1.0 / m[k, k, lane] if m[k, k, lane] > least[lane] else 0.0
        for i in range(size):
            if i != k:
                for lane in range(lanes):
                    share[lane] = pivot[lane] * m[i, k, lane]
                for j in range(size):
                    if j != k:
                        take(m[i, j], share, m[k, j])
        for i in range(size):
            for lane in range(lanes):
                m[i, k, lane] *= pivot[lane]
            put(m[k, i], m[i, k])
        for lane in range(lanes):
            m[k, k, lane] = -pivot[lane]
    for i in range(size):
        for j in range(size):
            for lane in range(lanes):
                m[i, j, lane] = -m[i, j, lane]
