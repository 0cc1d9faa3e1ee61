"""Many trajectories of the energy ROM in step, for vectors of the processor: the last axis of every array is the lane.

The equations are those of ``pod.kernel`` and ``pod.potential``; polynomials of all lanes are matrix products. What a lane
seldom needs, the potential outside the samples and a Newton matrix made definite, it does alone.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numba as nb
import numpy as np
from threadpoolctl import ThreadpoolController

from softrl.pod.inside import AXES, Inside, make_inside
from softrl.pod.insides import (
    begin_insides,
    end_insides,
    fill_drags,
    fill_gives,
    fill_masses,
    shared_energies,
)
from softrl.pod.kernel import AGAIN, CLOSE, LONGEST_STEP, MAX_ITERATIONS, share_of
from softrl.pod.lanes import (
    Lanes,
    add,
    fill_behind,
    fill_factor,
    fill_monomials,
    fill_rows,
    fill_slopes,
    fill_slopes_behind,
    fill_squares,
    fill_tangent,
    make_lanes,
    scale_down,
    squares_of,
    take,
    to_balls,
)
from softrl.pod.linear import newton_direction
from softrl.pod.potential import FAST, Tables, fill_potential
from softrl.pod.viscosity import TINY

LANES = 64  # trajectories in step: many for the matrix products, few enough for the cache


@cache
def _libraries() -> ThreadpoolController:
    """Return what holds the threads of libraries; it takes milliseconds to find them."""
    return ThreadpoolController()


def run_batch(
    y: np.ndarray, velocity: np.ndarray, dt_s: float, load: np.ndarray, tables: Tables
) -> tuple[np.ndarray, int, float]:
    """Roll out from ``y`` and ``velocity`` (B, r) under ``load`` (B, steps, r) Pa and N.

    Blocks of trajectories run in threads, one a core. Returns the path (B, steps, r), the number of steps that did not
    converge, and the largest ``|y|``; the same motions as ``pod.kernel.run_kernel`` makes, to round-off.
    """
    path = np.empty(load.shape)
    blocks = [slice(first, first + LANES) for first in range(0, len(y), LANES)]

    def run(block: slice) -> tuple[int, float]:
        moving = (np.array(part[block].T, order="C") for part in (y, velocity))
        return run_block(*moving, dt_s, load[block], tables, path[block])

    threads = ThreadPoolExecutor(min(len(blocks), len(os.sched_getaffinity(0))) or 1)
    with _libraries().limit(limits=1, user_api="blas"), threads:  # threads of linear algebra would wait for these, and spin
        ends = list(threads.map(run, blocks))
    return path, sum(failed for failed, _ in ends), max((farthest for _, farthest in ends), default=0.0)


@nb.njit(cache=True)
def _fill_mass(y: np.ndarray, velocity: np.ndarray, dt: float, tables: Any, insides: Inside, held: Lanes) -> None:
    """Fill roots and masses, those of the insides too, a step ahead of ``y`` (r, lanes), and all monomials there."""
    _fill_ahead(y, velocity, dt, held)
    wide = max(tables.mass_root.shape[1], tables.give_root.shape[1], tables.give.shape[1])
    fill_monomials(held.points, tables, held.values[:wide])
    fill_rows(tables.mass_root, held.values, held.root)
    fill_squares(held.root, held.mass)
    fill_masses(held.root, tables, held.values, insides)


@nb.njit(cache=True)
def _fill_ahead(y: np.ndarray, velocity: np.ndarray, dt: float, held: Lanes) -> None:
    """Fill ``points`` and ``radius`` of where ``y`` (r, lanes) is ``dt`` later if nothing turns it."""
    for i in range(len(y)):
        for lane in range(y.shape[1]):
            held.trial[i, lane] = y[i, lane] + dt * velocity[i, lane]
    to_balls(held.trial, held.points, held.radius)


@nb.njit(cache=True, error_model="numpy")
def _scale_rates(velocity: np.ndarray, inner: np.ndarray, kinetic: np.ndarray, insides: Inside, held: Lanes) -> None:
    """Scale all rates to twice the kinetic energies ``kinetic`` (lanes,)."""
    share = held.some[1]
    squares_of(held.mass, velocity, held.some[0], share)
    shared_energies(velocity, inner, insides, held.some[0], held.some[2])
    for lane in range(len(share)):
        share[lane] = share_of(kinetic[lane], share[lane] + held.some[2, lane])
    velocity *= share
    inner[1] *= share


@nb.njit(cache=True)
def _fill_turning(velocity: np.ndarray, held: Lanes) -> None:
    """Fill the force of turning from the roots and their gradients, as ``pod.kernel``."""
    points, force, outward, part, share = held.points, held.turning, held.some[0], held.some[1], held.some[2]
    moved, changed, along = held.wanted, held.gradient, held.trial
    r, lanes = velocity.shape
    outward[:] = 0.0
    for i in range(r):
        add(outward, points[i], velocity[i])
        moved[i], changed[i] = 0.0, 0.0
        for j in range(r):
            add(moved[i], held.root[i * r + j], velocity[j])
    fill_tangent(velocity, outward, held, along)
    force[:] = 0.0
    turned, inward = held.direction, held.some[3]
    inward[:] = 0.0
    for j in range(r):
        turned[j] = 0.0
        for a in range(r):
            part[:], share[:] = 0.0, 0.0
            add(share, along[j], moved[a])
            for i in range(r):
                row = held.slope[(j * r + a) * r + i]
                add(part, row, velocity[i])
                take(force[i], share, row)
            add(changed[a], along[j], part)
            add(turned[j], part, moved[a])
        add(inward, points[j], turned[j])
    fill_tangent(turned, inward, held, along)
    for j in range(r):
        for lane in range(lanes):
            force[j, lane] += along[j, lane]
        for a in range(r):
            take(force[j], held.root[a * r + j], changed[a])


@nb.njit(cache=True, error_model="numpy")
def _fill_viscosity(start: np.ndarray, by: np.ndarray, tables: Any, insides: Inside, held: Lanes) -> None:
    """Fill viscosity, the insides', and the forces of its slope half way of steps ``by`` (r, lanes), as ``pod.viscosity``."""
    steep, driven, outward = held.steep, held.some[3], held.some[2]
    wide = max(len(held.mixed), tables.drag_root.shape[1])
    _fill_ahead(start, by, 0.5, held)
    fill_monomials(held.points, tables, held.values[:wide])
    fill_rows(tables.elastic, held.values, held.pairs)
    fill_rows(tables.stiffness_root, held.values, held.root)
    fill_factor(held.pairs, tables.elastic[:, 0], held.matrix, held.some)
    fill_behind(held.root, held.matrix, held.product)
    fill_squares(held.product, held.stiff)
    fill_drags(held.product, tables, held.values, insides)
    fill_slopes_behind(by, held)
    fill_slopes(tables, held)
    outward[:], driven[:] = 0.0, 0.0
    for i in range(len(by)):
        add(outward, held.points[i], steep[i])
    fill_tangent(steep, outward, held, held.trial)
    for i in range(len(by)):
        for lane in range(by.shape[1]):
            steep[i, lane] = 0.25 * held.trial[i, lane]
        take(driven, steep[i], by[i])
    squares_of(held.stiff, by, held.some[0], held.some[1])
    for lane in range(by.shape[1]):
        share = max(1.0, driven[lane] / max(held.some[1, lane], TINY))
        for i in range(len(by)):
            steep[i, lane] /= share


@nb.njit(cache=True, fastmath=FAST, error_model="numpy")
def _begin(
    start: np.ndarray, ahead: np.ndarray, velocity: np.ndarray, load: np.ndarray, dt: float, tables: Any, held: Lanes
) -> None:
    """Fill what is constant in a step, and free flight ``ahead``, as ``pod.kernel.begin_step``; ``load`` (lanes, r)."""
    r, lanes = start.shape
    mass_scale, mass_damping, stiffness_damping = tables.scales[:3]
    for i in range(r):
        for lane in range(lanes):
            ahead[i, lane] = start[i, lane] + dt * velocity[i, lane]
    np.dot(tables.frame.T, load.T, held.right)
    for i in range(r):
        for lane in range(lanes):
            held.right[i, lane] += mass_scale * held.turning[i, lane] - stiffness_damping / dt * held.steep[i, lane]
        for j in range(r):
            for lane in range(lanes):
                mass = held.mass[i, j, lane]
                free = mass_scale / dt**2 * mass
                drag = (mass_damping * mass + stiffness_damping * held.stiff[i, j, lane]) / dt
                held.inertia[i, j, lane] = free + drag
                held.right[i, lane] += free * ahead[j, lane] + drag * start[j, lane]


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
    values, point, gradient, hessian = np.empty(len(tables.parent)), np.empty(r), np.empty(r), np.empty((r, r))
    fill_potential(y[:, lane].copy(), tables, values, point, gradient, hessian)
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


@nb.njit(cache=True, error_model="numpy")
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
def _converge(y: np.ndarray, waiting: np.ndarray, progress: np.ndarray, tables: Any, held: Lanes, most: int) -> int:
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


@nb.njit(cache=True, error_model="numpy")
def _end(
    y: np.ndarray, start: np.ndarray, velocity: np.ndarray, inner: np.ndarray, dt: float, insides: Inside, held: Lanes,
    energies: tuple[np.ndarray, np.ndarray],
) -> None:
    """Bring ``velocity`` and ``inner`` up to date and fill the energies (lanes,), as ``pod.kernel.end_step``."""
    (r, lanes), (kinetic, bent) = y.shape, energies
    for i in range(r):
        for lane in range(lanes):
            velocity[i, lane] = (y[i, lane] - start[i, lane]) / dt
    squares_of(held.mass, velocity, held.some[0], kinetic)
    end_insides(inner, y, dt, insides, held.some[0], bent)
    shared_energies(velocity, inner, insides, held.some[0], held.some[1])
    kinetic += held.some[1]
    for i in range(r):
        for lane in range(lanes):
            kinetic[lane] -= 2.0 * dt * held.turning[i, lane] * velocity[i, lane]
    np.maximum(kinetic, 0.0, kinetic)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def run_block(
    y: np.ndarray, velocity: np.ndarray, dt: float, load: np.ndarray, tables: Any, path: np.ndarray
) -> tuple[int, float]:
    """Fill ``path`` (lanes, steps, r) from ``y`` and ``velocity`` (r, lanes), used up, under ``load``."""
    r, lanes = y.shape
    held, start, ahead = make_lanes(r, lanes, tables), np.empty((r, lanes)), np.empty((r, lanes))
    waiting, progress = np.empty(lanes, dtype=np.bool_), np.empty((lanes, 2))
    kinetic, bent = np.empty(lanes), np.empty(lanes)
    insides, inner = make_inside(r, (lanes,)), np.zeros((2, AXES, lanes))
    to_balls(y, held.points, held.radius)
    failed, farthest, damped = 0, held.radius.max(), tables.scales[2] > 0.0
    _fill_mass(y, velocity, dt, tables, insides, held)
    fill_gives(tables, held.values, insides)
    for step in range(load.shape[1]):
        fill_rows(tables.mass_slope, held.values, held.slope)
        _fill_turning(velocity, held)
        start[:] = y
        for again in range(2 if damped else 1):  # viscosity is that half way to where the first iteration leads
            if damped:
                _fill_viscosity(start, y - start if again else dt * velocity, tables, insides, held)
            _begin(start, ahead, velocity, load[:, step].copy(), dt, tables, held)
            begin_insides(inner, ahead, start, dt, tables, insides, held.trial, held.inertia, held.right)
            if not again:
                y[:] = ahead
            missed = _converge(y, waiting, progress, tables, held, 1 if damped and not again else MAX_ITERATIONS)
        failed += missed
        path[:, step] = y.T
        _end(y, start, velocity, inner, dt, insides, held, (kinetic, bent))
        to_balls(y, held.points, held.radius)
        farthest = max(farthest, held.radius.max())
        for _ in range(AGAIN):  # the mass ahead hangs on the scaled velocity
            _fill_mass(y, velocity, dt, tables, insides, held)
            _scale_rates(velocity, inner, kinetic, insides, held)
        fill_gives(tables, held.values, insides)
        scale_down(inner[0], bent, insides.give, held.some)
    return failed, farthest
