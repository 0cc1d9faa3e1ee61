"""Inverse statics compiled: the pressures within limits whose equilibrium brings the tip nearest to a goal."""

from typing import Any

import numba as nb
import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.pod.step.kernel import run_kernel
from softrl.pod.step.linear import solve_positive
from softrl.pod.step.potential import fill_potential, make_room

ITERATIONS = 60
CLOSE_M = 1e-9


@nb.njit(cache=True)
def _equilibrium(y: np.ndarray, load: np.ndarray, dt: float, tables: Any, hooks: Any, empty: Any) -> None:
    """Bring ``y`` (r,) to the equilibrium under ``load`` (1, r)."""
    still = np.zeros(len(y))
    run_kernel(y, still, np.zeros((2, SHAPES)), still.copy(), dt, load, tables, hooks, empty[0], empty[1], empty[2])


@nb.njit(cache=True)
def _fill_tip(y: np.ndarray, frame: np.ndarray, tip: np.ndarray) -> None:
    n = len(y) - 3
    for k in range(3):
        tip[k] = 0.0
        for j in range(len(y)):
            tip[k] += frame[n + k, j] * y[j]


@nb.njit(cache=True)
def _fill_sensitivity(y: np.ndarray, tables: Any, out: np.ndarray) -> bool:
    """Fill ``out`` (3, n) m/Pa with d tip / d pressure at the equilibrium ``y``."""
    r, n = len(y), len(y) - 3
    gradient, hessian, scratch = np.empty(r), np.empty((r, r)), np.empty((r, r))
    moved = np.empty(r)
    fill_potential(y, tables, make_room(tables), gradient, hessian)
    for i in range(n):
        scratch[:] = hessian
        if not solve_positive(scratch, tables.frame[i], moved):
            return False
        for k in range(3):
            out[k, i] = 0.0
            for j in range(r):
                out[k, i] += tables.frame[n + k, j] * moved[j]
    return True


@nb.njit(cache=True)
def _bounded_step(
    sensitivity: np.ndarray,
    miss: np.ndarray,
    pressure: np.ndarray,
    limits: np.ndarray,
    damping: float,
    step: np.ndarray,
) -> None:
    """Fill ``step`` (n,) Pa: damped Gauss-Newton over the pressures that no limit holds back."""
    n = len(step)
    held = np.zeros(n, dtype=np.bool_)
    normal, right, answer = np.empty((n, n)), np.empty(n), np.empty(n)
    span = limits[1] - limits[0]
    largest = 0.0
    for i in range(n):
        largest = max(largest, sensitivity[0, i] ** 2 + sensitivity[1, i] ** 2 + sensitivity[2, i] ** 2)
    for _ in range(n + 1):
        for i in range(n):
            right[i] = 0.0
            for k in range(3):
                right[i] += sensitivity[k, i] * miss[k] * (0.0 if held[i] else 1.0)
            for j in range(n):
                normal[i, j] = 0.0
                if not (held[i] or held[j]):
                    for k in range(3):
                        normal[i, j] += sensitivity[k, i] * sensitivity[k, j]
            normal[i, i] += (damping + 1e-12) * largest + (largest if held[i] else 0.0)
        if not solve_positive(normal, right, answer):
            step[:] = 0.0
            return
        changed = False
        for i in range(n):
            step[i] = 0.0 if held[i] else answer[i]
            low = pressure[i] + step[i] < limits[0] and pressure[i] <= limits[0] + 1e-9 * span
            high = pressure[i] + step[i] > limits[1] and pressure[i] >= limits[1] - 1e-9 * span
            if not held[i] and (low or high):
                held[i] = changed = True
        if not changed:
            return


@nb.njit(cache=True)
def solve_pressures(
    goal: np.ndarray, limits: np.ndarray, tables: Any, hooks: Any, dt: float, pressure: np.ndarray, distance: np.ndarray
) -> None:
    """Fill ``pressure`` (S, n) Pa and ``distance`` (S,) m for tip displacements ``goal`` (S, 3) m.

    Levenberg's damping and a projection on ``limits`` (2,) Pa; ``dt`` is long enough to make a step an equilibrium.
    """
    r = len(tables.frame)
    n = r - 3
    load, trial_load = np.zeros((1, r)), np.zeros((1, r))
    tip, miss, step, sensitivity = np.empty(3), np.empty(3), np.empty(n), np.empty((3, n))
    empty = (np.empty((0, r)), np.empty((0, 3)), np.empty((0, 4)))
    for s in range(len(goal)):
        y = np.zeros(r)
        for i in range(n):
            load[0, i] = min(max(0.0, limits[0]), limits[1])
        _equilibrium(y, load, dt, tables, hooks, empty)
        _fill_tip(y, tables.frame, tip)
        left = 0.0
        for k in range(3):
            miss[k] = goal[s, k] - tip[k]
            left += miss[k] * miss[k]
        damping = 1e-6
        for _ in range(ITERATIONS):
            if left < CLOSE_M**2 or not _fill_sensitivity(y, tables, sensitivity):
                break
            better, moved = False, 0.0
            for _ in range(12):
                _bounded_step(sensitivity, miss, load[0, :n], limits, damping, step)
                moved = 0.0
                for i in range(n):
                    wanted = min(max(load[0, i] + step[i], limits[0]), limits[1])
                    moved = max(moved, abs(wanted - load[0, i]))
                    trial_load[0, i] = wanted
                trial = y.copy()
                _equilibrium(trial, trial_load, dt, tables, hooks, empty)
                _fill_tip(trial, tables.frame, tip)
                now = (goal[s, 0] - tip[0]) ** 2 + (goal[s, 1] - tip[1]) ** 2 + (goal[s, 2] - tip[2]) ** 2
                if now < left:
                    better = True
                    break
                damping *= 10.0
            if not better:
                break
            damping = max(0.1 * damping, 1e-9)
            y[:] = trial
            load[:] = trial_load
            stalled = now > (1.0 - 1e-10) * left
            left = now
            for k in range(3):
                miss[k] = goal[s, k] - tip[k]
            if stalled or moved < 1e-6:
                break
        for i in range(n):
            pressure[s, i] = load[0, i]
        distance[s] = np.sqrt(left)
