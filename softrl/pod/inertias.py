"""The inertia of many trajectories in step, as ``pod.inertia``: the last axis of every array is the lane."""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.pod.inertia import Course
from softrl.pod.inside import AXES, Inside
from softrl.pod.insides import fill_masses, shared_energies
from softrl.pod.lanes import (
    Lanes,
    add,
    add_scaled,
    add_times,
    combine,
    fill_monomials,
    fill_rows,
    fill_squares,
    take,
    to_balls,
)


@nb.njit(cache=True)
def fill_amplitudes(
    y: np.ndarray, least: int, with_lead: bool, tables: Any, held: Lanes, amplitudes: np.ndarray, lead: np.ndarray
) -> None:
    """Fill the amplitudes (k, lanes) at ``y`` (r, lanes) and their gradients, as ``pod.inertia.fill_amplitudes``."""
    r = len(y)
    to_balls(y, held.points, held.radius)
    fill_monomials(held.points, tables, held.values[: max(least, tables.amplitudes.shape[1])])
    fill_rows(tables.amplitudes, held.values, amplitudes)
    outside = held.radius.max() > 1.0
    if with_lead or outside:
        fill_rows(tables.amplitude_slope, held.values, lead)
    if outside:
        for a in range(len(amplitudes)):
            for i in range(r):
                add(amplitudes[a], lead[a * r + i], y[i])
                take(amplitudes[a], lead[a * r + i], held.points[i])


@nb.njit(cache=True)
def fill_inertias(start: np.ndarray, by: np.ndarray, tables: Any, insides: Inside, course: Course, held: Lanes) -> None:
    """Fill amplitudes and masses where steps ``by`` (r, lanes) from ``start`` lead, as ``pod.inertia.fill_inertia``."""
    course.aim[:] = start
    course.aim[:] += by
    fill_amplitudes(course.aim, tables.give_root.shape[1], True, tables, held, course.ahead, course.lead)
    fill_squares(course.lead, held.mass)
    _fill_roots(held.mass, held.root)
    fill_masses(held.root, tables, held.values, insides)


@nb.njit(cache=True, error_model="numpy")
def _fill_roots(mass: np.ndarray, root: np.ndarray) -> None:
    """Fill ``root`` (r r, lanes) with the triangles of ``pod.inertia.fill_root``."""
    r = len(mass)
    root[:] = 0.0
    for i in range(r):
        for j in range(i, r):
            root[i * r + j] = mass[i, j]
            for k in range(i):
                take(root[i * r + j], root[k * r + i], root[k * r + j])
        for lane in range(mass.shape[2]):
            root[i * r + i, lane] = math.sqrt(max(root[i * r + i, lane], 0.0))
        for j in range(i + 1, r):
            for lane in range(mass.shape[2]):
                pivot = root[i * r + i, lane]
                root[i * r + j, lane] = root[i * r + j, lane] / pivot if pivot > 0.0 else 0.0


@nb.njit(cache=True)
def add_inertias(free: float, drag: float, course: Course, held: Lanes) -> None:
    """Add the forces of inertia to ``inertia`` and ``right``, as ``pod.inertia.add_inertia``."""
    r, force = len(held.right), held.some[0]
    for i in range(r):
        for j in range(r):
            add_times(held.inertia[i, j], free + drag, held.mass[i, j])
            add_scaled(held.right[i], free + drag, held.mass[i, j], course.aim[j])
    for a in range(len(course.now)):
        combine(free + drag, course.ahead[a], -2.0 * free - drag, course.now[a], free, course.before[a], force)
        for i in range(r):
            take(held.right[i], course.lead[a * r + i], force)


@nb.njit(cache=True)
def fill_kinetic(
    velocity: np.ndarray, inner: np.ndarray, dt: float, insides: Inside, course: Course, held: Lanes, kinetic: np.ndarray
) -> None:
    """Fill twice the kinetic energies (lanes,), as ``pod.inertia.kinetic_energy``."""
    shared_energies(velocity, inner, insides, held.some[0], kinetic)
    rate = held.some[0]
    for a in range(len(course.now)):
        combine(1.0 / dt, course.now[a], -1.0 / dt, course.before[a], 0.0, course.now[a], rate)
        add(kinetic, rate, rate)


@nb.njit(cache=True)
def fill_work(
    y: np.ndarray, velocity: np.ndarray, former: np.ndarray, giving: np.ndarray, formerly: np.ndarray, dt: float,
    insides: Inside, course: Course, held: Lanes, work: np.ndarray,
) -> None:
    """Fill twice the works (lanes,), as ``pod.inertia.work_of_inertia``."""
    r, rate, moved = len(velocity), held.some[0], held.some[1]
    by, changed, gained = (y - course.aim) / dt, giving - formerly, velocity - former
    work[:] = 0.0
    for a in range(len(course.now)):
        moved[:] = 0.0
        combine(1.0 / dt, course.ahead[a], -2.0 / dt, course.now[a], 1.0 / dt, course.before[a], rate)
        for i in range(r):
            add(rate, course.lead[a * r + i], by[i])
            add(moved, course.lead[a * r + i], velocity[i])
        add(work, rate, moved)
    for i in range(r):
        for k in range(AXES):
            moved[:] = 0.0
            add(moved, velocity[i], changed[k])
            add(moved, gained[i], giving[k])
            add(work, insides.couple[i, k], moved)
    for j in range(AXES):
        rate[:] = 0.0
        for k in range(AXES):
            add(rate, insides.own[j, k], changed[k])
        add(work, rate, giving[j])
    work *= 2.0
