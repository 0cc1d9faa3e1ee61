"""The inertia of many trajectories in step, as ``pod.step.inertia``: the last axis of every array is the lane."""

import math
from typing import Any

import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.core.compiled import borrowing, standing
from softrl.pod.lanes.algebra import (
    Lanes,
    add,
    add_scaled,
    add_times,
    combine,
    fill_squares,
    largest,
    put,
    put_rate,
    put_times,
    take,
    to_balls,
)
from softrl.pod.lanes.columns import Columns, fill_leads, fill_monomials
from softrl.pod.lanes.insides import fill_masses, shared_energies
from softrl.pod.lanes.products import multiply
from softrl.pod.step.inertia import Course
from softrl.pod.step.inside import Inside


@standing
def fill_amplitudes(
    y: np.ndarray, lanes: int, tables: Any, columns: Columns, held: Lanes, amplitudes: np.ndarray, lead: np.ndarray
) -> None:
    """Fill the amplitudes (k, >= lanes) at the first ``lanes`` of ``y`` (r, >= lanes); ``lead`` is scratch.

    As ``pod.step.inertia.fill_amplitudes``.
    """
    to_balls(y, held.points, held.radius[:lanes])
    fill_monomials(held.points, tables, lanes, held.values[: len(columns.amplitudes)])
    multiply(columns.amplitudes, held.values, 0, len(columns.amplitudes), lanes, amplitudes)
    if largest(held.radius[:lanes]) > 1.0:
        multiply(columns.amplitude_slope, held.values, 0, len(columns.amplitude_slope), lanes, lead)
        _go_on(y, lanes, lead, amplitudes, held)


@standing
def _go_on(y: np.ndarray, lanes: int, lead: np.ndarray, amplitudes: np.ndarray, held: Lanes) -> None:
    """Add to ``amplitudes`` what they change by from the unit ball to ``y``; nothing at all for lanes inside."""
    r, beyond = len(y), held.wanted
    for i in range(r):
        put_rate(beyond[i, :lanes], y[i], held.points[i], 1.0)
    for a in range(len(amplitudes)):
        for i in range(r):
            add(amplitudes[a, :lanes], lead[a * r + i], beyond[i])


@standing
def fill_inertias(
    aim: np.ndarray, tables: Any, columns: Columns, insides: Inside, course: Course, held: Lanes
) -> None:
    """Fill amplitudes and masses where steps lead, ``aim`` (r, lanes), as ``pod.step.inertia.fill_inertia``.

    ``held`` then has the monomials there of which the potential's Hessian is made.
    """
    for i in range(len(aim)):
        put(course.aim[i], aim[i])
    most = max(len(columns.hessian), len(columns.amplitude_slope), len(columns.inner_root))
    to_balls(aim, held.points, held.radius)
    fill_monomials(held.points, tables, aim.shape[1], held.values[:most])
    fill_leads(columns, held, course.lead, course.ahead)
    if largest(held.radius) > 1.0:
        _go_on(aim, aim.shape[1], course.lead, course.ahead, held)
    fill_squares(course.lead, held.mass)
    _fill_roots(held.mass, held.root)
    fill_masses(held.root, columns, held.values, insides)


@standing
def _fill_roots(mass: np.ndarray, root: np.ndarray) -> None:
    """Fill ``root`` (r r, lanes) with the triangles of ``pod.step.inertia.fill_root``."""
    r = len(mass)
    root[:] = 0.0
    for i in range(r):
        for j in range(i, r):
            put(root[i * r + j], mass[i, j])
            for k in range(i):
                take(root[i * r + j], root[k * r + i], root[k * r + j])
        for lane in range(mass.shape[2]):
            root[i * r + i, lane] = math.sqrt(max(root[i * r + i, lane], 0.0))
        for j in range(i + 1, r):
            for lane in range(mass.shape[2]):
                pivot = root[i * r + i, lane]
                root[i * r + j, lane] = root[i * r + j, lane] / pivot if pivot > 0.0 else 0.0


@standing
def add_inertias(free: float, drag: float, course: Course, held: Lanes) -> None:
    """Add the forces of inertia to ``inertia`` and ``right``, as ``pod.step.inertia.add_inertia``."""
    r, force = len(held.right), held.some[0]
    for i in range(r):
        for j in range(r):
            add_times(held.inertia[i, j], free + drag, held.mass[i, j])
            add_scaled(held.right[i], free + drag, held.mass[i, j], course.aim[j])
    for a in range(len(course.now)):
        combine(free + drag, course.ahead[a], -2.0 * free - drag, course.now[a], free, course.before[a], force)
        for i in range(r):
            take(held.right[i], course.lead[a * r + i], force)


@standing
def fill_kinetic(
    velocity: np.ndarray, inner: np.ndarray, dt: float, insides: Inside, course: Course, held: Lanes, kinetic: np.ndarray
) -> None:
    """Fill twice the kinetic energies (lanes,), as ``pod.step.inertia.kinetic_energy``."""
    shared_energies(velocity, inner, insides, held.some[0], kinetic)
    rate = held.some[0]
    for a in range(len(course.now)):
        combine(1.0 / dt, course.now[a], -1.0 / dt, course.before[a], 0.0, course.now[a], rate)
        add(kinetic, rate, rate)


@borrowing
def kinetic_of(lane: int, velocity: np.ndarray, inner: np.ndarray, dt: float, insides: Inside, course: Course) -> float:
    """Return twice the kinetic energy of one lane, as ``fill_kinetic``."""
    total = 0.0
    for a in range(len(course.now)):
        total += ((course.now[a, lane] - course.before[a, lane]) / dt) ** 2
    for k in range(SHAPES):
        for i in range(len(velocity)):
            total += 2.0 * velocity[i, lane] * insides.couple[i, k, lane] * inner[1, k, lane]
        for j in range(SHAPES):
            total += inner[1, j, lane] * insides.own[j, k, lane] * inner[1, k, lane]
    return total


@standing
def fill_work(
    y: np.ndarray, velocity: np.ndarray, giving: np.ndarray, dt: float, insides: Inside, course: Course, held: Lanes,
    work: np.ndarray,
) -> None:
    """Fill twice the works (lanes,), as ``pod.step.inertia.work_of_inertia``; the ``former`` rates are used up."""
    r, rate, moved = len(velocity), held.some[0], held.some[1]
    by, changed, gained = held.wanted, held.formerly, held.former
    for i in range(r):
        put_rate(by[i], y[i], course.aim[i], dt)
        put_rate(gained[i], velocity[i], gained[i], 1.0)
    for k in range(SHAPES):
        put_rate(changed[k], giving[k], changed[k], 1.0)
    work[:] = 0.0
    for a in range(len(course.now)):
        moved[:] = 0.0
        combine(1.0 / dt, course.ahead[a], -2.0 / dt, course.now[a], 1.0 / dt, course.before[a], rate)
        for i in range(r):
            add(rate, course.lead[a * r + i], by[i])
            add(moved, course.lead[a * r + i], velocity[i])
        add(work, rate, moved)
    for i in range(r):
        for k in range(SHAPES):
            moved[:] = 0.0
            add(moved, velocity[i], changed[k])
            add(moved, gained[i], giving[k])
            add(work, insides.couple[i, k], moved)
    for j in range(SHAPES):
        rate[:] = 0.0
        for k in range(SHAPES):
            add(rate, insides.own[j, k], changed[k])
        add(work, rate, giving[j])
    put_times(work, 2.0, work)
