"""Many trajectories of the energy ROM in step, for vectors of the processor: the last axis of every array is the lane.

The equations are those of ``pod.kernel`` and ``pod.potential``; polynomials of all lanes are matrix products.
"""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba as nb
import numpy as np

from softrl.core.compiled import FAST
from softrl.core.threads import one_thread
from softrl.pod.chords import fill_viscosities
from softrl.pod.inertia import Course, make_course
from softrl.pod.inertias import add_inertias, fill_amplitudes, fill_inertias, fill_kinetic, fill_work
from softrl.pod.inside import AXES, Inside, make_inside
from softrl.pod.insides import begin_insides, end_insides, fill_gives
from softrl.pod.kernel import MAX_ITERATIONS, SCALINGS
from softrl.pod.lanes import Lanes, add, add_times, fill_monomials, make_lanes, scale_down, to_balls
from softrl.pod.newtons import converge
from softrl.pod.potential import Tables

LANES = 128  # trajectories in step: many for the matrix products, few enough for the cache


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
    with one_thread(), threads:
        ends = list(threads.map(run, blocks))
    return path, sum(failed for failed, _ in ends), max((farthest for _, farthest in ends), default=0.0)


@nb.njit(cache=True, fastmath=FAST, error_model="numpy")
def _begin(
    start: np.ndarray, ahead: np.ndarray, velocity: np.ndarray, load: np.ndarray, dt: float, tables: Any, course: Course,
    held: Lanes,
) -> None:
    """Fill what is constant in a step, and free flight ``ahead``, as ``pod.kernel.begin_step``; ``load`` (lanes, r)."""
    r, lanes = start.shape
    free, drag, late = tables.scales[0] / dt**2, tables.scales[1] / dt, tables.scales[2] / dt
    for i in range(r):
        for lane in range(lanes):
            ahead[i, lane] = start[i, lane] + dt * velocity[i, lane]
    np.dot(tables.frame.T, load.T, held.right)
    for i in range(r):
        add_times(held.right[i], -late, held.steep[i])
        for j in range(r):
            held.inertia[i, j] = late * held.stiff[i, j]
            add(held.right[i], held.inertia[i, j], start[j])
    add_inertias(free, drag, course, held)


@nb.njit(cache=True, error_model="numpy")
def _end(
    y: np.ndarray, start: np.ndarray, velocity: np.ndarray, inner: np.ndarray, dt: float, tables: Any, insides: Inside,
    course: Course, held: Lanes, energies: tuple[np.ndarray, np.ndarray],
) -> None:
    """Bring rates, amplitudes and the energies (lanes,) up to date, as ``pod.kernel.end_step``."""
    kinetic, bent = energies
    share, most = held.some[3], held.some[4]
    former, formerly = velocity.copy(), inner[1].copy()
    velocity[:] = (y - start) / dt
    end_insides(inner, y, dt, insides, held.some[0], bent)
    fill_work(y, velocity, former, inner[1], formerly, dt, insides, course, held, most)
    for lane in range(len(most)):
        most[lane] = max(kinetic[lane] + most[lane], 0.0)
    course.before[:] = course.now
    fill_amplitudes(y, 0, False, tables, held, course.now, course.lead)
    fill_kinetic(velocity, inner, dt, insides, course, held, kinetic)
    for _ in range(SCALINGS):
        if (kinetic <= most).all():
            break
        for lane in range(len(most)):
            share[lane] = math.sqrt(most[lane] / kinetic[lane]) if kinetic[lane] > most[lane] else 1.0
        velocity *= share
        inner[1] *= share
        fill_amplitudes(y - dt * velocity, 0, False, tables, held, course.before, course.lead)
        fill_kinetic(velocity, inner, dt, insides, course, held, kinetic)


@nb.njit(cache=True)
def _set_out(
    y: np.ndarray, velocity: np.ndarray, inner: np.ndarray, bent: np.ndarray, dt: float, tables: Any, insides: Inside,
    held: Lanes,
) -> None:
    """Fill the insides' stiffnesses and scale them back to the energies ``bent`` (lanes,), as ``pod.kernel``."""
    to_balls(y + 0.5 * dt * velocity, held.points, held.radius)
    fill_monomials(held.points, tables, held.values[: tables.give.shape[1]])
    fill_gives(tables, held.values, insides)
    scale_down(inner[0], bent, insides.give, held.some)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def run_block(
    y: np.ndarray, velocity: np.ndarray, dt: float, load: np.ndarray, tables: Any, path: np.ndarray
) -> tuple[int, float]:
    """Fill ``path`` (lanes, steps, r) from ``y`` and ``velocity`` (r, lanes), used up, under ``load``."""
    r, lanes = y.shape
    held, start, ahead = make_lanes(r, lanes, tables), np.empty((r, lanes)), np.empty((r, lanes))
    waiting, progress = np.empty(lanes, dtype=np.bool_), np.empty((lanes, 2))
    kinetic, bent = np.empty(lanes), np.full(lanes, np.inf)
    insides, inner = make_inside(r, (lanes,)), np.zeros((2, AXES, lanes))
    to_balls(y, held.points, held.radius)
    failed, farthest = 0, held.radius.max()
    course = make_course(r, len(tables.amplitudes), (lanes,))
    fill_amplitudes(y - dt * velocity, 0, False, tables, held, course.before, course.lead)
    fill_inertias(y, np.zeros((r, lanes)), tables, insides, course, held)
    course.now[:] = course.ahead
    fill_kinetic(velocity, inner, dt, insides, course, held, kinetic)
    _set_out(y, velocity, inner, bent, dt, tables, insides, held)
    for step in range(load.shape[1]):
        start[:] = y
        for again in range(2):  # inertia is that where the first iteration leads, viscosity that half way there
            by = y - start if again else dt * velocity
            fill_inertias(start, by, tables, insides, course, held)
            if tables.scales[2] > 0.0:
                fill_viscosities(start, by, tables, insides, held)
            _begin(start, ahead, velocity, load[:, step].copy(), dt, tables, course, held)
            begin_insides(inner, ahead, start, dt, tables, insides, held.trial, held.inertia, held.right)
            if not again:
                y[:] = ahead
            missed = converge(y, waiting, progress, tables, held, MAX_ITERATIONS if again else 1)
        failed += missed
        path[:, step] = y.T
        _end(y, start, velocity, inner, dt, tables, insides, course, held, (kinetic, bent))
        _set_out(y, velocity, inner, bent, dt, tables, insides, held)
        to_balls(y, held.points, held.radius)
        farthest = max(farthest, held.radius.max())
    return failed, farthest
