"""A step that leads far from where it was taken to: its inertia and viscosity anew, of one trajectory among many."""

from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.core.compiled import standing
from softrl.pod.lanes.algebra import Lanes
from softrl.pod.step.inertia import Course, make_course
from softrl.pod.step.inside import Inside, make_inside
from softrl.pod.step.kernel import begin_step, fill_resistance


class Alone(NamedTuple):
    """One trajectory's step, r coordinates, as ``pod.step.kernel`` has it.

    Attributes
    ----------
    start, by, ahead, velocity, load, right, steep : (r,);  inner : (2, 6);  inertia, mass, stiff : (r, r)
    inside, course : its own
    """

    start: np.ndarray
    by: np.ndarray
    ahead: np.ndarray
    velocity: np.ndarray
    load: np.ndarray
    right: np.ndarray
    steep: np.ndarray
    inner: np.ndarray
    inertia: np.ndarray
    mass: np.ndarray
    stiff: np.ndarray
    inside: Inside
    course: Course


@nb.njit(cache=True)
def make_alone(r: int, count: int) -> Alone:
    """Return room for ``r`` coordinates and ``count`` amplitudes."""
    return Alone(
        np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros((2, SHAPES)),
        np.zeros((r, r)), np.zeros((r, r)), np.zeros((r, r)), make_inside(r, ()), make_course(r, count, ()),
    )  # fmt: skip


@standing
def aim_alone(
    place: int, start: np.ndarray, velocity: np.ndarray, inner: np.ndarray, load: np.ndarray, dt: float, tables: Any,
    insides: Inside, course: Course, held: Lanes, one: Alone,
) -> None:
    """Take the step of the lane that is at ``place`` in ``order`` to lead where it is moving, and begin it anew."""
    lane, r = held.order[place], len(start)
    for i in range(r):
        one.start[i], one.velocity[i], one.load[i] = start[i, lane], velocity[i, lane], load[i, lane]
        one.by[i] = held.moving[i, place] - start[i, lane]
    for k in range(SHAPES):
        one.inner[0, k], one.inner[1, k] = inner[0, k, lane], inner[1, k, lane]
        for j in range(SHAPES):
            one.inside.give[j, k] = insides.give[j, k, lane]
    for a in range(len(course.now)):
        one.course.before[a], one.course.now[a] = course.before[a, lane], course.now[a, lane]
    own = one.mass, one.stiff, one.steep, one.inside, one.course
    fill_resistance(one.start, one.by, tables, held.room, own)
    begin_step(one.velocity, one.inner, one.load, dt, tables, own, one.start, one.ahead, one.inertia, one.right)
    held.progress[place, 0] = -1.0
    for i in range(r):
        held.right[i, place], held.steep[i, lane], course.aim[i, lane] = one.right[i], one.steep[i], one.course.aim[i]
        for j in range(r):
            held.inertia[i, j, place], held.mass[i, j, lane] = one.inertia[i, j], one.mass[i, j]
    for a in range(len(course.now)):
        course.ahead[a, lane] = one.course.ahead[a]
        for i in range(r):
            course.lead[a * r + i, lane] = one.course.lead[a * r + i]
    _return_inside(lane, one.inside, insides)


@standing
def _return_inside(lane: int, one: Inside, insides: Inside) -> None:
    """Bring what a step knows of the inside of one trajectory to its ``lane``."""
    for k in range(SHAPES):
        insides.push[k, lane], insides.flown[k, lane] = one.push[k], one.flown[k]
        for i in range(len(one.pull)):
            insides.pull[i, k, lane] = one.pull[i, k]
            insides.couple[i, k, lane], insides.drag[i, k, lane] = one.couple[i, k], one.drag[i, k]
        for j in range(SHAPES):
            insides.own[j, k, lane], insides.tough[j, k, lane] = one.own[j, k], one.tough[j, k]
            insides.inverse[j, k, lane] = one.inverse[j, k]
