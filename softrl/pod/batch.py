"""Many trajectories of the energy ROM in step, for vectors of the processor: the last axis of every array is the lane.

The equations are those of ``pod.kernel`` and ``pod.potential``; polynomials of all lanes are matrix products.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numba as nb
import numpy as np
from threadpoolctl import ThreadpoolController

from softrl.pod.inside import AXES, Inside, make_inside
from softrl.pod.insides import begin_insides, end_insides, fill_gives, fill_masses, shared_energies
from softrl.pod.kernel import AGAIN, MAX_ITERATIONS, share_of
from softrl.pod.lanes import (
    Lanes,
    add,
    fill_ahead,
    fill_monomials,
    fill_rows,
    fill_squares,
    fill_tangent,
    make_lanes,
    scale_down,
    squares_of,
    take,
    to_balls,
)
from softrl.pod.newtons import converge
from softrl.pod.potential import FAST, Tables
from softrl.pod.viscosities import fill_viscosities

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
    fill_ahead(y, velocity, dt, held)
    wide = max(tables.mass_root.shape[1], tables.give_root.shape[1], tables.give.shape[1])
    fill_monomials(held.points, tables, held.values[:wide])
    fill_rows(tables.mass_root, held.values, held.root)
    fill_squares(held.root, held.mass)
    fill_masses(held.root, tables, held.values, insides)


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
                fill_viscosities(start, y - start if again else dt * velocity, tables, insides, held)
            _begin(start, ahead, velocity, load[:, step].copy(), dt, tables, held)
            begin_insides(inner, ahead, start, dt, tables, insides, held.trial, held.inertia, held.right)
            if not again:
                y[:] = ahead
            missed = converge(y, waiting, progress, tables, held, 1 if damped and not again else MAX_ITERATIONS)
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
