"""What a time step's inertia is: the full model's own differences of positions, compiled.

Its nodes x change by ``M (x_1 - 2 x_0 + x_-1) / dt^2``. The reduced body knows x by its amplitudes, those of modes that are
orthonormal in the mass: their gradient A makes the mass ``A'A``, and ``A'(a_1 - 2 a_0 + a_-1) / dt^2`` is the force. So a body
that turns is led along its curve, however far a step is.
"""

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.core.compiled import borrowing
from softrl.pod.step.inside import fill_mass, shared_energy
from softrl.pod.step.potential import fill_monomials, fill_rows, fill_square, to_ball


class Course(NamedTuple):
    """The k amplitudes in a step, kg^0.5 m.

    Attributes
    ----------
    before, now, ahead : (k,) a step ago, at its start, and at ``aim``;  lead : (k r,) their gradient there, row by row
    aim : (r,) where the step is taken to lead
    other : (k,), spare : (k r,) scratch: the next step begins with what was found at ``aim``
    """

    before: np.ndarray
    now: np.ndarray
    ahead: np.ndarray
    lead: np.ndarray
    aim: np.ndarray
    other: np.ndarray
    spare: np.ndarray


@nb.njit(cache=True)
def make_course(r: int, count: int, lanes: tuple[int, ...]) -> Course:
    """Return the room that ``count`` amplitudes need: ``lanes`` as in ``pod.step.inside.make_inside``."""
    one, many = (count, *lanes), (count * r, *lanes)
    return Course(
        np.zeros(one), np.zeros(one), np.zeros(one), np.zeros(many), np.zeros((r, *lanes)), np.zeros(one), np.zeros(many)
    )


@borrowing
def fill_amplitudes(
    y: np.ndarray, least: int, with_lead: bool, tables: Any, work: Any, amplitudes: np.ndarray, lead: np.ndarray
) -> None:
    """Fill the amplitudes (k,) at ``y``, and if ``with_lead`` their gradient (k r,); outside the ball they go on straight.

    ``least`` is the number of monomials that ``work`` is to hold afterwards.
    """
    values, point = work.values, work.point
    r, radius = len(y), to_ball(y, point)
    fill_monomials(point, tables.parent, tables.variable, values[: max(least, tables.amplitudes.shape[1])])
    fill_rows(tables.amplitudes, values, amplitudes)
    if with_lead or radius > 1.0:
        fill_rows(tables.amplitude_slope, values, lead)
    if radius > 1.0:
        for a in range(len(amplitudes)):
            for i in range(r):
                amplitudes[a] += lead[a * r + i] * (y[i] - point[i])


@borrowing
def fill_inertia(start: np.ndarray, by: np.ndarray, tables: Any, work: Any, held: Any) -> None:
    """Fill amplitudes, mass and the inside's masses where the step ``by`` (r,) from ``start`` leads.

    ``work`` and ``held`` are those of ``pod.step.kernel``.
    """
    mass, _, _, inside, course = held
    for i in range(len(by)):
        course.aim[i] = start[i] + by[i]
    fill_amplitudes(course.aim, tables.inner_root.shape[1], True, tables, work, course.ahead, course.lead)
    fill_square(course.lead, mass)
    fill_root(mass, work.root)
    fill_mass(work.root, tables, work.values, inside)


@borrowing
def fill_root(mass: np.ndarray, root: np.ndarray) -> None:
    """Fill ``root`` (r r,) with the upper triangular R of ``mass`` = R'R (r, r), no row where it is not positive."""
    r = len(mass)
    for i in range(r):
        for j in range(r):
            total = mass[i, j] if j >= i else 0.0
            for k in range(i if j >= i else 0):
                total -= root[k * r + i] * root[k * r + j]
            if j == i:
                root[i * r + i] = math.sqrt(total) if total > 0.0 else 0.0
            else:
                root[i * r + j] = total / root[i * r + i] if root[i * r + i] > 0.0 else 0.0


@borrowing
def add_inertia(free: float, drag: float, held: Any, inertia: np.ndarray, right: np.ndarray) -> None:
    """Add the force of inertia, ``inertia`` (r, r) y - ``right`` (r,), which is exact at ``aim`` and linear around it.

    ``free`` and ``drag`` are the mass scale by the square of the step and the mass damping by the step.
    """
    mass, course = held[0], held[4]
    r = len(right)
    for i in range(r):
        for j in range(r):
            inertia[i, j] += (free + drag) * mass[i, j]
            right[i] += (free + drag) * mass[i, j] * course.aim[j]
    for a in range(len(course.now)):
        change = course.ahead[a] - course.now[a]
        force = free * (change - course.now[a] + course.before[a]) + drag * change
        for i in range(r):
            right[i] -= course.lead[a * r + i] * force


@borrowing
def kinetic_energy(velocity: np.ndarray, inner: np.ndarray, dt: float, held: Any) -> float:
    """Return twice the kinetic energy, at mass scale 1, after a step at ``velocity`` and the rate of ``inner``."""
    course, total = held[4], 0.0
    for a in range(len(course.now)):
        total += ((course.now[a] - course.before[a]) / dt) ** 2
    return total + shared_energy(velocity, inner, held[3])


@borrowing
def work_of_inertia(
    y: np.ndarray, velocity: np.ndarray, former: np.ndarray, giving: np.ndarray, formerly: np.ndarray, dt: float, held: Any
) -> float:
    """Return twice the work in a step to ``y`` that the other forces do, by those of inertia which they balance.

    At mass scale 1.

    Parameters
    ----------
    velocity, former : (r,) of this step and of the last
    giving, formerly : (6,) rate of the inside, likewise
    """
    inside, course = held[3], held[4]
    r, total = len(velocity), 0.0
    for a in range(len(course.now)):
        moved = 0.0
        rate = (course.ahead[a] - 2.0 * course.now[a] + course.before[a]) / dt
        for i in range(r):
            rate += course.lead[a * r + i] * (y[i] - course.aim[i]) / dt
            moved += course.lead[a * r + i] * velocity[i]
        total += rate * moved
    for i in range(r):
        for k in range(SHAPES):
            change = velocity[i] * (giving[k] - formerly[k]) + (velocity[i] - former[i]) * giving[k]
            total += inside.couple[i, k] * change
    for j in range(SHAPES):
        for k in range(SHAPES):
            total += giving[j] * inside.own[j, k] * (giving[k] - formerly[k])
    return 2.0 * total
