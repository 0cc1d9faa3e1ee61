"""Newton's iteration of many trajectories in step: the last axis of every array is the lane.

What a lane seldom needs, the potential outside the samples and a Newton matrix made definite, it does alone.
"""

from typing import Any

import numba as nb
import numpy as np

from softrl.core.compiled import borrowing
from softrl.pod.kernel import CLOSE, LONGEST_STEP
from softrl.pod.lanes import Lanes, add, fill_monomials, fill_rows, take, to_balls
from softrl.pod.linear import newton_direction
from softrl.pod.potential import fill_potential, make_room


@nb.njit(cache=True)
def _fill_wanted(y: np.ndarray, waiting: np.ndarray, tables: Any, held: Lanes) -> None:
    """Fill gradient and Newton's direction at ``y`` (r, lanes), those of lanes that do not wait for nothing."""
    r, lanes = y.shape
    to_balls(y, held.points, held.radius)
    fill_monomials(held.points, tables, held.values[: tables.gradient.shape[1]])
    fill_rows(tables.gradient, held.values, held.gradient)
    fill_rows(tables.hessian, held.values, held.pairs)
    for lane in range(lanes):
        if waiting[lane] and held.radius[lane] > 1.0:
            _fill_outside(y, lane, tables, held)
    for i in range(r):
        for lane in range(lanes):
            held.gradient[i, lane] -= held.right[i, lane]
        for j in range(r):
            add(held.gradient[i], held.inertia[i, j], y[j])
    _solve(waiting, tables, held)


@nb.njit(cache=True)
def _fill_outside(y: np.ndarray, lane: int, tables: Any, held: Lanes) -> None:
    """Fill the potential's derivatives of one lane outside the samples."""
    r = len(y)
    gradient, hessian = np.empty(r), np.empty((r, r))
    fill_potential(y[:, lane].copy(), tables, make_room(tables), gradient, hessian)
    pair = 0
    for i in range(r):
        held.gradient[i, lane] = gradient[i]
        for j in range(i, r):
            held.pairs[pair, lane] = hessian[i, j]
            pair += 1


@nb.njit(cache=True, error_model="numpy")
def _solve(waiting: np.ndarray, tables: Any, held: Lanes) -> None:
    """Fill ``wanted`` by LDL' of the Hessians in ``pairs`` with inertia; lanes that are not definite go alone."""
    matrix, wanted, pivot, least = held.matrix, held.wanted, held.some[0], held.some[1]
    r, lanes = wanted.shape
    least[:] = np.inf
    pair = 0
    for i in range(r):  # row i of the upper triangle becomes D L' there
        for j in range(i, r):
            for lane in range(lanes):
                matrix[i, j, lane] = held.pairs[pair, lane] + held.inertia[i, j, lane]
            pair += 1
        wanted[i] = held.gradient[i]
    for k in range(r):
        for lane in range(lanes):
            least[lane] = min(least[lane], matrix[k, k, lane])
            pivot[lane] = 1.0 / matrix[k, k, lane]
        for i in range(k + 1, r):
            share = matrix[i, k]
            for lane in range(lanes):
                share[lane] = matrix[k, i, lane] * pivot[lane]
            for j in range(i, r):
                take(matrix[i, j], share, matrix[k, j])
            take(wanted[i], share, wanted[k])
        for lane in range(lanes):
            wanted[k, lane] *= pivot[lane]
    for i in range(r - 1, -1, -1):
        for k in range(i + 1, r):
            take(wanted[i], matrix[k, i], wanted[k])
    for lane in range(lanes):
        if waiting[lane] and not least[lane] > 0.0:
            _solve_alone(lane, tables, held)


@nb.njit(cache=True)
def _solve_alone(lane: int, tables: Any, held: Lanes) -> None:
    """Fill the direction of one lane, whose Newton matrix has to be made definite."""
    r = len(held.wanted)
    matrix, scratch, direction = np.empty((r, r)), np.empty((r, r)), np.empty(r)
    pair = 0
    for i in range(r):
        for j in range(i, r):
            matrix[i, j] = matrix[j, i] = held.pairs[pair, lane] + held.inertia[i, j, lane]
            pair += 1
    newton_direction(matrix, tables.quadratic, held.gradient[:, lane].copy(), True, scratch, direction)
    held.wanted[:, lane] = direction


@borrowing
def _move(y: np.ndarray, lane: int, progress: np.ndarray, held: Lanes) -> float:
    """Move ``y`` of one lane by what ``wanted`` says, or back by half, as ``pod.kernel.iterate``."""
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


@nb.njit(cache=True)
def converge(y: np.ndarray, waiting: np.ndarray, progress: np.ndarray, tables: Any, held: Lanes, most: int) -> int:
    """Move ``y`` to where the forces balance, in ``most`` iterations; return the number of lanes that do not get there."""
    waiting[:], progress[:] = True, -1.0
    for _ in range(most):
        _fill_wanted(y, waiting, tables, held)
        for lane in range(len(waiting)):
            if waiting[lane]:
                waiting[lane] = _move(y, lane, progress[lane], held) >= CLOSE
        if not waiting.any():
            break
    return waiting.sum()
