"""Newton's iteration of many trajectories in step: the last axis of every array is the lane.

What a lane seldom needs, the potential outside the samples and a Newton matrix made definite, it does alone.
"""

from typing import Any

import numpy as np

from softrl.core.compiled import borrowing, standing
from softrl.pod.lanes.algebra import Lanes, add, put, take, to_balls
from softrl.pod.lanes.columns import Columns, fill_curves, fill_monomials
from softrl.pod.lanes.pasts import foretell_potentials, keep
from softrl.pod.step.kernel import LONGEST_STEP, NEAR
from softrl.pod.step.linear import newton_direction
from softrl.pod.step.past import Past
from softrl.pod.step.potential import fill_potential


@standing
def fill_potentials(y: np.ndarray, lanes: int, known: bool, tables: Any, columns: Columns, held: Lanes) -> None:
    """Fill ``gradient`` and ``pairs``, the Hessian, at the first ``lanes`` of ``y`` (r, >= lanes); monomials may be ``known``."""
    if not known:
        to_balls(y, held.points, held.radius[:lanes])
        fill_monomials(held.points, tables, lanes, held.values[: len(columns.hessian)])
    fill_curves(tables, columns, held, lanes)
    for lane in range(lanes):
        if held.radius[lane] > 1.0:
            _fill_outside(y, lane, tables, held)


@standing
def _fill_wanted(y: np.ndarray, lanes: int, tables: Any, held: Lanes) -> None:
    """Fill Newton's direction at the first ``lanes`` of ``y`` (r, >= lanes), and add inertia to the ``gradient``."""
    for i in range(len(y)):
        for lane in range(lanes):
            held.gradient[i, lane] -= held.right[i, lane]
        for j in range(len(y)):
            add(held.gradient[i, :lanes], held.inertia[i, j], y[j])
    _solve(lanes, tables, held)


@standing
def _fill_outside(y: np.ndarray, lane: int, tables: Any, held: Lanes) -> None:
    """Fill the potential's derivatives of one lane outside the samples."""
    r = len(y)
    hessian, gradient, point = held.alone[:r], held.alone[2 * r], held.alone[2 * r + 1]
    for i in range(r):
        point[i] = y[i, lane]
    fill_potential(point, tables, held.room, gradient, hessian)
    pair = 0
    for i in range(r):
        held.gradient[i, lane] = gradient[i]
        for j in range(i, r):
            held.pairs[pair, lane] = hessian[i, j]
            pair += 1


@standing
def _solve(lanes: int, tables: Any, held: Lanes) -> None:
    """Fill ``wanted`` by LDL' of the Hessians in ``pairs`` with inertia; lanes that are not definite go alone."""
    matrix, wanted, pivot, least = held.matrix, held.wanted, held.some[0], held.some[1]
    r = len(wanted)
    least[:] = np.inf
    pair = 0
    for i in range(r):  # row i of the upper triangle becomes D L' there
        for j in range(i, r):
            for lane in range(lanes):
                matrix[i, j, lane] = held.pairs[pair, lane] + held.inertia[i, j, lane]
            pair += 1
        put(wanted[i, :lanes], held.gradient[i])
    for k in range(r):
        for lane in range(lanes):
            least[lane] = min(least[lane], matrix[k, k, lane])
            pivot[lane] = 1.0 / matrix[k, k, lane]
        for i in range(k + 1, r):
            share = matrix[i, k]
            for lane in range(lanes):
                share[lane] = matrix[k, i, lane] * pivot[lane]
            for j in range(i, r):
                take(matrix[i, j, :lanes], share, matrix[k, j])
            take(wanted[i, :lanes], share, wanted[k])
        for lane in range(lanes):
            wanted[k, lane] *= pivot[lane]
    for i in range(r - 1, -1, -1):
        for k in range(i + 1, r):
            take(wanted[i, :lanes], matrix[k, i], wanted[k])
    for lane in range(lanes):
        if not least[lane] > 0.0:
            _solve_alone(lane, tables, held)


@standing
def _solve_alone(lane: int, tables: Any, held: Lanes) -> None:
    """Fill the direction of one lane, whose Newton matrix has to be made definite."""
    r = len(held.wanted)
    matrix, scratch, gradient, direction = held.alone[:r], held.alone[r : 2 * r], held.alone[2 * r], held.alone[2 * r + 1]
    pair = 0
    for i in range(r):
        gradient[i] = held.gradient[i, lane]
        for j in range(i, r):
            matrix[i, j] = matrix[j, i] = held.pairs[pair, lane] + held.inertia[i, j, lane]
            pair += 1
    newton_direction(matrix, tables.quadratic, gradient, True, scratch, direction)
    for i in range(r):
        held.wanted[i, lane] = direction[i]


@borrowing
def _move(y: np.ndarray, lane: int, progress: np.ndarray, held: Lanes) -> float:
    """Move ``y`` of one lane by what ``wanted`` says, or back by half, as ``pod.step.kernel.iterate``."""
    along = longest = slope = 0.0
    for i in range(len(y)):
        along += held.gradient[i, lane] * held.direction[i, lane]
        slope += held.gradient[i, lane] * held.wanted[i, lane]
        longest = max(longest, abs(held.wanted[i, lane]))
    if progress[0] >= 0.0 and along < -0.9 * progress[0] and progress[1] > 0.01:
        progress[1] *= 0.5
        for i in range(len(y)):
            y[i, lane] = held.trial[i, lane] - progress[1] * held.direction[i, lane]
        return np.inf
    progress[0] = abs(slope)
    progress[1] = 1.0 if longest < LONGEST_STEP else LONGEST_STEP / longest
    for i in range(len(y)):
        held.direction[i, lane] = held.wanted[i, lane]
        held.trial[i, lane] = y[i, lane]
        y[i, lane] -= progress[1] * held.wanted[i, lane]
    return longest


@borrowing
def _bring(source: int, target: int, held: Lanes) -> None:
    """Bring what Newton's iteration knows of the lane ``source`` to the place ``target``."""
    r = len(held.moving)
    for i in range(r):
        for j in range(r):
            held.inertia[i, j, target] = held.inertia[i, j, source]
        for part in (held.right, held.trial, held.direction, held.moving):
            part[i, target] = part[i, source]
    for k in range(2):
        held.progress[target, k] = held.progress[source, k]
    held.order[target] = held.order[source]


@standing
def aim(y: np.ndarray, past: Past, tables: Any, held: Lanes) -> None:
    """Move ``y`` (r, lanes) by one iteration, for which the potential is foretold."""
    foretell_potentials(y, past, held)
    _fill_wanted(y, y.shape[1], tables, held)
    for lane in range(y.shape[1]):
        held.progress[lane, 0] = -1.0
        _move(y, lane, held.progress[lane], held)


@standing
def release(y: np.ndarray, held: Lanes) -> None:
    """Let Newton's iteration move all lanes of ``y`` (r, lanes)."""
    for i in range(len(y)):
        put(held.moving[i], y[i])
    for lane in range(y.shape[1]):
        held.order[lane], held.progress[lane, 0], held.progress[lane, 1] = lane, -1.0, -1.0


@standing
def converge(
    y: np.ndarray, lanes: int, known: bool, past: Past, tables: Any, columns: Columns, held: Lanes, most: int
) -> int:
    """Move ``lanes`` of ``y``, with which ``order`` begins, to where the forces balance, in ``most`` iterations.

    Return the number of them that do not get there, with which ``order`` begins then. Lanes that are there go from among the
    others, whose ``inertia`` and ``right`` close up. Monomials at ``moving`` may be ``known``.
    """
    for iteration in range(most if lanes > 0 else 0):
        fill_potentials(held.moving, lanes, known and iteration == 0, tables, columns, held)
        keep(held.moving, lanes, past, held)
        _fill_wanted(held.moving, lanes, tables, held)
        left = 0
        for lane in range(lanes):
            waits = _move(held.moving, lane, held.progress[lane], held) >= NEAR
            for i in range(len(y)):
                y[i, held.order[lane]] = held.moving[i, lane]
            if waits and left < lane:
                _bring(lane, left, held)
            left += waits
        lanes = left
        if lanes == 0:
            break
    return lanes
