"""Many trajectories of the energy ROM in step, for vectors of the processor: the last axis of every array is the lane.

The equations are those of ``pod.step.kernel`` and ``pod.step.potential``; polynomials of all lanes are matrix products.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba as nb
import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.core.compiled import standing
from softrl.core.threads import cores
from softrl.pod.lanes.algebra import (
    Lanes,
    add,
    add_times,
    largest,
    make_lanes,
    put,
    put_rate,
    put_sum,
    put_times,
    scale_down,
    to_balls,
)
from softrl.pod.lanes.alone import aim_alone, make_alone
from softrl.pod.lanes.chords import fill_metrics, fill_viscosities, go_half_way
from softrl.pod.lanes.columns import Columns, columns_of
from softrl.pod.lanes.inertias import add_inertias, fill_amplitudes, fill_inertias, fill_kinetic, fill_work, kinetic_of
from softrl.pod.lanes.insides import begin_insides, end_insides, fill_gives
from softrl.pod.lanes.newtons import aim, converge, fill_potentials, release
from softrl.pod.lanes.pasts import keep, keep_curves, make_pasts
from softrl.pod.lanes.products import TILE
from softrl.pod.step.inertia import Course, make_course
from softrl.pod.step.inside import Inside, make_inside
from softrl.pod.step.kernel import MAX_ITERATIONS, SCALINGS
from softrl.pod.step.past import Past
from softrl.pod.step.potential import Tables

LANES = 64  # trajectories in step, at most: enough for vectors, few enough for the cache; a multiple of a tile's


def run_batch(
    y: np.ndarray, velocity: np.ndarray, dt_s: float, load: np.ndarray, tables: Tables
) -> tuple[np.ndarray, int, float]:
    """Roll out from ``y`` and ``velocity`` (B, r) under ``load`` (B, steps, r) Pa and N.

    Blocks of trajectories run in threads, one a core. Returns the path (B, steps, r), the number of steps that did not
    converge, and the largest ``|y|``; the same motions as ``pod.step.kernel.run_kernel`` makes, to round-off, and bit for bit the
    same in whatever block.
    """
    path, columns = np.empty(load.shape), columns_of(tables)
    lanes = min(LANES, _whole_tiles(-(-len(y) // cores())) or TILE)
    blocks = [slice(first, first + lanes) for first in range(0, len(y), lanes)]

    def run(block: slice) -> tuple[int, float]:
        count = len(y[block])
        filled = np.minimum(np.arange(_whole_tiles(count)), count - 1)  # the last trajectory again and again
        moving = (np.array(part[block][filled].T, order="C") for part in (y, velocity))
        push = np.ascontiguousarray(load[block][filled].transpose(1, 2, 0))
        return run_block(*moving, dt_s, push, tables, columns, path[block])

    with ThreadPoolExecutor(min(len(blocks), cores()) or 1) as threads:
        ends = list(threads.map(run, blocks))
    return path, sum(failed for failed, _ in ends), max((farthest for _, farthest in ends), default=0.0)


def _whole_tiles(lanes: int) -> int:
    """Return the lanes of as many tiles as hold ``lanes``."""
    return -(-lanes // TILE) * TILE


@standing
def _begin(
    start: np.ndarray, ahead: np.ndarray, inner: np.ndarray, load: np.ndarray, dt: float, tables: Any, course: Course,
    insides: Inside, held: Lanes,
) -> None:
    """Fill what is constant in a step, as ``pod.step.kernel.begin_step``; ``load`` (r, lanes)."""
    r = len(start)
    free, drag, late = tables.scales[0] / dt**2, tables.scales[1] / dt, tables.scales[2] / dt
    for i in range(r):
        held.right[i] = 0.0
        add_times(held.right[i], -late, held.steep[i])
        for j in range(r):
            add_times(held.right[i], tables.frame[j, i], load[j])
            put_times(held.inertia[i, j], late, held.stiff[i, j])
            add(held.right[i], held.inertia[i, j], start[j])
    add_inertias(free, drag, course, held)
    begin_insides(inner, ahead, start, dt, tables, insides, held.trial, held.inertia, held.right)


@standing
def _fill_half_way(by: np.ndarray, tables: Any, columns: Columns, insides: Inside, held: Lanes) -> None:
    """Fill the viscosities of steps ``by`` (r, lanes) that are half way at ``middle``, where the body has any."""
    if tables.scales[2] > 0.0:
        go_half_way(held.middle, tables, columns, held)
        fill_viscosities(by, tables, columns, insides, held)


@standing
def _look_back(
    y: np.ndarray, by: np.ndarray, past: Past, tables: Any, columns: Columns, insides: Inside, held: Lanes
) -> None:
    """Fill ``past`` and viscosities as steps ``by`` (r, lanes) that led to ``y`` would have left them, as ``pod.step.kernel``."""
    lanes, steps = y.shape[1], held.trial
    for i in range(len(y)):
        put_sum(held.middle[i], y[i], -0.5, by[i])
    _fill_half_way(by, tables, columns, insides, held)
    for lane in range(lanes):
        held.order[lane] = lane
    for back in (1, 0):
        for i in range(len(y)):
            put_sum(steps[i], y[i], -back, by[i])
        fill_potentials(steps, lanes, False, tables, columns, held)
        keep(steps, lanes, past, held)
        if back == 1:
            keep_curves(past)


@standing
def _end(
    y: np.ndarray, start: np.ndarray, velocity: np.ndarray, inner: np.ndarray, dt: float, tables: Any, columns: Columns,
    insides: Inside, course: Course, held: Lanes, energies: tuple[np.ndarray, np.ndarray],
) -> float:
    """Bring rates, amplitudes and the energies (lanes,) up to date, as ``end_step`` of one; return the largest ``|y|``."""
    kinetic, bent = energies
    most = held.some[4]
    for i in range(len(y)):
        put(held.former[i], velocity[i])
        put_rate(velocity[i], y[i], start[i], dt)
    for k in range(SHAPES):
        put(held.formerly[k], inner[1, k])
    end_insides(inner, y, dt, insides, held.some[0], bent)
    fill_work(y, velocity, inner[1], dt, insides, course, held, most)
    for lane in range(len(most)):
        most[lane] = max(kinetic[lane] + most[lane], 0.0)
    for a in range(len(course.now)):
        put(course.before[a], course.now[a])
    fill_amplitudes(y, y.shape[1], tables, columns, held, course.now, course.spare)
    farthest = largest(held.radius)
    fill_kinetic(velocity, inner, dt, insides, course, held, kinetic)
    _hold_back(y, velocity, inner, dt, tables, columns, insides, course, held, energies[0])
    return farthest


@standing
def _hold_back(
    y: np.ndarray, velocity: np.ndarray, inner: np.ndarray, dt: float, tables: Any, columns: Columns, insides: Inside,
    course: Course, held: Lanes, kinetic: np.ndarray,
) -> None:
    """Scale the rates of lanes whose energy is above what it may be, ``some[4]``, as ``end_step`` of one: these alone."""
    most = held.some[4]
    for _ in range(SCALINGS):
        over = 0
        for lane in range(len(kinetic)):
            if kinetic[lane] > most[lane]:
                share = math.sqrt(most[lane] / kinetic[lane])
                for k in range(SHAPES):
                    inner[1, k, lane] *= share
                for i in range(len(y)):
                    velocity[i, lane] *= share
                    held.middle[i, over] = y[i, lane] - dt * velocity[i, lane]
                held.order[over] = lane
                over += 1
        if over == 0:
            break
        fill_amplitudes(held.middle, over, tables, columns, held, course.other, course.spare)
        for place in range(over):
            lane = held.order[place]
            for a in range(len(course.now)):
                course.before[a, lane] = course.other[a, place]
            kinetic[lane] = kinetic_of(lane, velocity, inner, dt, insides, course)


@standing
def _set_out(
    y: np.ndarray, velocity: np.ndarray, inner: np.ndarray, bent: np.ndarray, dt: float, tables: Any, columns: Columns,
    insides: Inside, held: Lanes,
) -> None:
    """Fill viscosities and the insides' stiffnesses, scaled back to the energies ``bent`` (lanes,), as ``pod.step.kernel``."""
    for i in range(len(y)):
        put_sum(held.middle[i], y[i], 0.5 * dt, velocity[i])
    go_half_way(held.middle, tables, columns, held)
    fill_gives(columns, held.values, insides)
    if tables.scales[2] > 0.0:
        fill_metrics(tables, columns, held, held.stiff)
    scale_down(inner[0], bent, insides.give, held.some)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def run_block(
    y: np.ndarray, velocity: np.ndarray, dt: float, load: np.ndarray, tables: Any, columns: Columns, path: np.ndarray
) -> tuple[int, float]:
    """Fill ``path`` (B, steps, r) from ``y`` and ``velocity`` (r, lanes), used up, under ``load`` (steps, r, lanes).

    There are whole tiles of lanes; ``path`` is that of the first ones, as many as it has room for.
    """
    r, lanes = y.shape
    held, start, ahead, by = make_lanes(r, lanes, tables), np.empty((r, lanes)), np.empty((r, lanes)), np.zeros((r, lanes))
    kinetic, bent, past = np.empty(lanes), np.full(lanes, np.inf), make_pasts(r, lanes)
    insides, inner = make_inside(r, (lanes,)), np.zeros((2, SHAPES, lanes))
    to_balls(y, held.points, held.radius)
    failed, farthest = 0, held.radius.max()
    course, alone = make_course(r, len(tables.amplitudes), (lanes,)), make_alone(r, len(tables.amplitudes))
    fill_amplitudes(y - dt * velocity, lanes, tables, columns, held, course.before, course.spare)
    _look_back(y, dt * velocity, past, tables, columns, insides, held)
    fill_inertias(y, tables, columns, insides, course, held)
    course.now[:] = course.ahead
    fill_kinetic(velocity, inner, dt, insides, course, held, kinetic)
    _set_out(y, velocity, inner, bent, dt, tables, columns, insides, held)
    for step in range(len(load)):
        for i in range(r):
            put(start[i], y[i])
            put_sum(ahead[i], y[i], dt, velocity[i])
            put(y[i], ahead[i])
        _begin(start, ahead, inner, load[step], dt, tables, course, insides, held)
        aim(y, past, tables, held)
        for i in range(r):  # inertia is that where the first iteration leads, viscosity that half way there
            put_rate(by[i], y[i], start[i], 1.0)
            put_sum(held.middle[i], start[i], 0.5, by[i])
        _fill_half_way(by, tables, columns, insides, held)
        fill_inertias(y, tables, columns, insides, course, held)
        _begin(start, ahead, inner, load[step], dt, tables, course, insides, held)
        release(y, held)
        left = converge(y, lanes, True, past, tables, columns, held, 1)
        for place in range(left):
            aim_alone(place, start, velocity, inner, load[step], dt, tables, insides, course, held, alone)
        missed = converge(y, left, False, past, tables, columns, held, MAX_ITERATIONS - 1)
        for lane in range(len(path)):
            path[lane, step] = y[:, lane]
        failed += (held.order[:missed] < len(path)).sum()
        farthest = max(farthest, _end(y, start, velocity, inner, dt, tables, columns, insides, course, held, (kinetic, bent)))
        _set_out(y, velocity, inner, bent, dt, tables, columns, insides, held)
    return failed, farthest
