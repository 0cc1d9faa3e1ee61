"""Many trajectories of the energy ROM in step: polynomials of all at once as matrix products, the rest one by one."""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba as nb
import numpy as np

from softrl.pod.kernel import (
    CLOSE,
    MAX_ITERATIONS,
    begin_step,
    end_step,
    fill_turning,
    fill_viscosity,
    iterate,
    scale_to,
    square_of,
)
from softrl.pod.potential import Tables, fill_potential, fill_square, to_ball

LANES = 32  # trajectories in step: enough for the matrix products, few enough for the cache


def run_batch(
    y: np.ndarray, velocity: np.ndarray, lag: np.ndarray, dt_s: float, load: np.ndarray, tables: Tables
) -> tuple[np.ndarray, int, float]:
    """Roll out from ``y``, ``velocity`` and ``lag`` (B, r), which are used up, under ``load`` (B, steps, r) Pa and N.

    Blocks of trajectories run in threads, one a core. Returns the path (B, steps, r), the number of steps that did not
    converge, and the largest ``|y|``; the same motions as ``pod.kernel.run_kernel`` makes, to round-off.
    """
    path = np.empty(load.shape)
    blocks = [slice(first, first + LANES) for first in range(0, len(y), LANES)]

    def run(block: slice) -> tuple[int, float]:
        return run_block(y[block], velocity[block], lag[block], dt_s, load[block], tables, path[block])

    with ThreadPoolExecutor(min(len(blocks), len(os.sched_getaffinity(0))) or 1) as threads:
        ends = list(threads.map(run, blocks))
    return path, sum(failed for failed, _ in ends), max((farthest for _, farthest in ends), default=0.0)


@nb.njit(cache=True)
def _fill_monomials(points: np.ndarray, tables: Any, values: np.ndarray) -> None:
    """Fill the monomials ``values`` (k, lanes) at ``points`` (r, lanes)."""
    lanes = points.shape[1]
    values[0] = 1.0
    for k in range(1, len(values)):
        lower, variable = tables.parent[k], tables.variable[k]
        for lane in range(lanes):
            values[k, lane] = values[lower, lane] * points[variable, lane]


@nb.njit(cache=True)
def _fill_rows(coefficients: np.ndarray, values: np.ndarray, rows: np.ndarray) -> None:
    """Fill ``rows`` (lanes, m) with the polynomials ``coefficients`` (m, k) at monomials ``values`` (>= k, lanes)."""
    if coefficients.shape[1] > 0:
        np.dot(values[: coefficients.shape[1]].T, coefficients.T, rows)
    else:
        rows[:] = 0.0


@nb.njit(cache=True)
def _to_balls(y: np.ndarray, scratch: np.ndarray, points: np.ndarray, radius: np.ndarray) -> None:
    """Fill the nearest points (r, lanes) of the unit ball to ``y`` (lanes, r), and their ``radius`` (lanes,)."""
    for lane in range(len(y)):
        radius[lane] = to_ball(y[lane], scratch)
        for i in range(len(scratch)):
            points[i, lane] = scratch[i]


@nb.njit(cache=True)
def _fill_mass(
    y: np.ndarray, tables: Any, values: np.ndarray, points: np.ndarray, radius: np.ndarray, vector: np.ndarray,
    root: np.ndarray, slope: np.ndarray, mass: np.ndarray,
) -> None:
    """Fill roots (lanes, r r), their gradients (lanes, r r r) and masses (lanes, r, r) at ``y`` (lanes, r)."""
    _to_balls(y, vector, points, radius)
    _fill_monomials(points, tables, values[: tables.mass_root.shape[1]])
    _fill_rows(tables.mass_root, values, root)
    _fill_rows(tables.mass_slope, values, slope)
    for lane in range(len(y)):
        fill_square(root[lane], mass[lane])


@nb.njit(cache=True, nogil=True)
def run_block(
    y: np.ndarray, velocity: np.ndarray, lag: np.ndarray, dt: float, load: np.ndarray, tables: Any, path: np.ndarray
) -> tuple[int, float]:
    """Fill ``path`` for the lanes ``y``, ``velocity`` and ``lag`` (lanes, r), used up, and ``load`` (lanes, steps, r)."""
    lanes, r = y.shape
    pairs = len(tables.elastic)
    values, points, radius = np.empty((len(tables.parent), lanes)), np.empty((r, lanes)), np.empty(lanes)
    mass, stiff, loose = np.zeros((lanes, r, r)), np.zeros((lanes, r, r)), np.zeros((lanes, r, r))
    turning, start, inertia, right = np.empty((lanes, r)), np.empty((lanes, r)), np.empty((lanes, r, r)), np.empty((lanes, r))
    root, other = np.empty((lanes, r * r)), np.empty((lanes, r * r))
    slope, bend, push = np.empty((lanes, r * r * r)), np.empty((lanes, pairs)), np.empty((lanes, r))
    direction, trial, progress = np.empty((lanes, r)), np.empty((lanes, r)), np.empty((lanes, 2))
    halfway, point, lone = np.empty((lanes, r)), np.empty(r), np.empty(len(tables.parent))
    scratch, jacobian, product = np.empty((r, r)), np.empty((r, r)), np.empty(r * r)
    waiting = np.empty(lanes, dtype=np.bool_)
    wide = max(tables.elastic.shape[1], tables.stiffness_root.shape[1], tables.lag_root.shape[1])
    failed, farthest = 0, 0.0
    _fill_mass(y, tables, values, points, radius, point, root, slope, mass)
    for step in range(load.shape[1]):
        for lane in range(lanes):
            farthest = max(farthest, radius[lane])
            point[:] = points[:, lane]
            fill_turning(radius[lane], velocity[lane], point, root[lane], slope[lane], scratch, turning[lane])
            for i in range(r):
                halfway[lane, i] = y[lane, i] + 0.5 * dt * velocity[lane, i]
        if tables.scales[2] > 0.0:
            _to_balls(halfway, point, points, radius)
            _fill_monomials(points, tables, values[:wide])
            _fill_rows(tables.elastic, values, bend)
            _fill_rows(tables.stiffness_root, values, root)
            _fill_rows(tables.lag_root, values, other)
        for lane in range(lanes):
            if tables.scales[2] > 0.0:
                stored = square_of(loose[lane], lag[lane]) if step > 0 else np.inf
                fill_viscosity(
                    bend[lane], root[lane], other[lane], tables, scratch, product, stiff[lane], loose[lane]
                )
                scale_to(lag[lane], stored, loose[lane], False)
            held = (mass[lane], stiff[lane], loose[lane], turning[lane])
            begin_step(
                y[lane], velocity[lane], lag[lane], load[lane, step], dt, tables, held, start[lane], inertia[lane],
                right[lane],
            )
        waiting[:] = True
        progress[:, 0] = -1.0
        for _ in range(MAX_ITERATIONS):
            _to_balls(y, point, points, radius)
            _fill_monomials(points, tables, values[: tables.gradient.shape[1]])
            _fill_rows(tables.gradient, values, push)
            _fill_rows(tables.hessian, values, bend)
            left = 0
            for lane in range(lanes):
                if not waiting[lane]:
                    continue
                if radius[lane] > 1.0:
                    fill_potential(y[lane], tables, lone, point, push[lane], jacobian)
                else:
                    _spread(bend[lane], jacobian)
                for i in range(r):
                    for j in range(r):
                        jacobian[i, j] += inertia[lane, i, j]
                longest = iterate(
                    y[lane], push[lane], jacobian, inertia[lane], right[lane], tables, True, scratch, direction[lane],
                    trial[lane], progress[lane],
                )
                waiting[lane] = longest >= CLOSE
                left += waiting[lane]
            if left == 0:
                break
        for lane in range(lanes):
            failed += waiting[lane]
            path[lane, step] = y[lane]
            held = (mass[lane], stiff[lane], loose[lane], turning[lane])
            progress[lane, 0], _ = end_step(y[lane], velocity[lane], lag[lane], dt, tables, held, start[lane])
        _fill_mass(y, tables, values, points, radius, point, root, slope, mass)
        for lane in range(lanes):
            scale_to(velocity[lane], progress[lane, 0], mass[lane], True)
    for lane in range(lanes):
        farthest = max(farthest, radius[lane])
    return failed, farthest


@nb.njit(cache=True)
def _spread(pairs: np.ndarray, matrix: np.ndarray) -> None:
    """Fill the symmetric ``matrix`` (r, r) from its upper triangle."""
    pair = 0
    for i in range(len(matrix)):
        for j in range(i, len(matrix)):
            matrix[i, j] = matrix[j, i] = pairs[pair]
            pair += 1
