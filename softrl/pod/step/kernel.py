"""The energy ROM compiled: implicit Euler with effects inside the step."""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.core.compiled import borrowing, standing, summing
from softrl.effects.port import GRAVITY
from softrl.pod.step.chord import fill_metric
from softrl.pod.step.inertia import (
    add_inertia,
    fill_amplitudes,
    fill_inertia,
    kinetic_energy,
    make_course,
    work_of_inertia,
)
from softrl.pod.step.inside import begin_inside, end_inside, fill_give, make_inside, stored_in
from softrl.pod.step.linear import newton_direction
from softrl.pod.step.past import foretell_potential, keep, make_past
from softrl.pod.step.ports import add_effects, commit_effects, fill_elastic, fill_ports, go_on, make_ports
from softrl.pod.step.pose import tip_pose
from softrl.pod.step.potential import fill_monomials, fill_potential, make_room, to_ball
from softrl.pod.step.viscosity import fill_viscosity

CLOSE = 1e-6  # change of y in an iteration after which what is left is below a nanometre at the tip, with effects
NEAR = 1e-4  # likewise without: Newton's iteration is exact then, and what is left falls with the square
MAX_ITERATIONS = 60
LONGEST_STEP = 0.5  # of y, in one iteration
SCALINGS = 5  # of rates, until they hold no more energy than they may


@summing
def begin_step(
    velocity: np.ndarray, inner: np.ndarray, load: np.ndarray, dt: float, tables: Any, held: Any, start: np.ndarray,
    ahead: np.ndarray, inertia: np.ndarray, right: np.ndarray,
) -> None:
    """Fill what is constant in a step from ``start``: ``inertia`` (r, r) y - ``right`` (r,), and free flight ``ahead``.

    ``held`` are the mass (r, r), viscosity (r, r) and the force of its slope (r,), the ``pod.step.inside``, and the amplitudes'
    ``pod.step.inertia.Course``.
    """
    _, stiff, steep, inside, _ = held
    r, free = len(start), tables.scales[0] / dt**2
    drag, late = tables.scales[1] / dt, tables.scales[2] / dt
    for i in range(r):
        ahead[i] = start[i] + dt * velocity[i]
        total = -late * steep[i]
        for k in range(r):
            total += tables.frame[k, i] * load[k]
        for j in range(r):
            inertia[i, j] = late * stiff[i, j]
            total += inertia[i, j] * start[j]
        right[i] = total
    add_inertia(free, drag, held, inertia, right)
    begin_inside(inner, ahead, start, dt, tables, inside, inertia, right)


@borrowing
def iterate(
    y: np.ndarray, gradient: np.ndarray, jacobian: np.ndarray, inertia: np.ndarray, right: np.ndarray, tables: Any,
    symmetric: bool, scratch: np.ndarray, direction: np.ndarray, trial: np.ndarray, progress: np.ndarray,
) -> float:
    """Move ``y`` by one iteration of Newton's method; return the longest change it wanted, or inf where it goes back.

    ``gradient`` and ``jacobian`` are the potential's at ``y``, without inertia in the former; ``progress`` (2,) is the
    slope along the last direction, negative in the first iteration, and the share of it that was taken.
    """
    r = len(y)
    along = 0.0
    for i in range(r):
        total = gradient[i] - right[i]
        for j in range(r):
            total += inertia[i, j] * y[j]
        gradient[i] = total
        along += total * direction[i] if progress[0] >= 0.0 else 0.0
    # the last step went too far if the slope along it has turned round: go back by half
    if progress[0] >= 0.0 and along < -0.9 * progress[0] and progress[1] > 0.01:
        progress[1] *= 0.5
        for i in range(r):
            y[i] = trial[i] - progress[1] * direction[i]
        return np.inf
    newton_direction(jacobian, tables.quadratic, gradient, symmetric, scratch, direction)
    longest = slope = 0.0
    for i in range(r):
        longest = max(longest, abs(direction[i]))
        slope += gradient[i] * direction[i]
    progress[0] = abs(slope)
    progress[1] = 1.0 if longest < LONGEST_STEP else LONGEST_STEP / longest
    for i in range(r):
        trial[i] = y[i]
        y[i] -= progress[1] * direction[i]
    return longest


@borrowing
def end_step(
    y: np.ndarray, velocity: np.ndarray, inner: np.ndarray, dt: float, tables: Any, work: Any, held: Any,
    start: np.ndarray, kinetic: float,
) -> tuple[float, float]:
    """Bring rates and amplitudes up to date; return twice the kinetic energy and twice what the inside stores.

    ``kinetic`` was the former before the step. The rates are scaled down where it would grow by more than the work of the
    forces.
    """
    former, formerly, course = work.former, work.formerly, held[4]
    for k in range(len(formerly)):
        formerly[k] = inner[1, k]
    for i in range(len(y)):
        former[i] = velocity[i]
        velocity[i] = (y[i] - start[i]) / dt
    bent = end_inside(inner, y, dt, held[3])
    most = max(kinetic + work_of_inertia(y, velocity, former, inner[1], formerly, dt, held), 0.0)
    for a in range(len(course.now)):
        course.before[a] = course.now[a]
    fill_amplitudes(y, 0, False, tables, work, course.now, course.spare)
    now = kinetic_energy(velocity, inner, dt, held)
    for _ in range(SCALINGS):
        if now <= most:
            break
        share = math.sqrt(most / now)
        for k in range(len(formerly)):
            inner[1, k] *= share
        for i in range(len(y)):
            velocity[i] *= share
            work.middle[i] = y[i] - dt * velocity[i]
        fill_amplitudes(work.middle, 0, False, tables, work, course.before, course.spare)
        now = kinetic_energy(velocity, inner, dt, held)
    return now, bent


@standing
def fill_resistance(start: np.ndarray, by: np.ndarray, tables: Any, work: Any, held: Any) -> None:
    """Fill inertia and viscosity of a step ``by`` (r,) from ``start``."""
    fill_inertia(start, by, tables, work, held)
    if tables.scales[2] > 0.0:
        fill_viscosity(start, by, tables, work, held)


@standing
def _look_back(
    y: np.ndarray, by: np.ndarray, tables: Any, work: Any, held: Any, past: Any, trial: np.ndarray, gradient: np.ndarray,
    hessian: np.ndarray,
) -> None:
    """Fill ``past`` and ``held`` as a step ``by`` (r,) that led to ``y`` would have left them; the last three are scratch."""
    for i in range(len(y)):
        trial[i] = y[i] - by[i]
    fill_potential(trial, tables, work, gradient, past.curve_before)
    fill_resistance(trial, by, tables, work, held)
    fill_potential(y, tables, work, gradient, hessian)
    keep(past, y, gradient, hessian)


@borrowing
def _set_out(
    y: np.ndarray, velocity: np.ndarray, inner: np.ndarray, bent: float, dt: float, tables: Any, work: Any, held: Any
) -> None:
    """Fill viscosity and the inside's stiffness half way of free flight.

    The inside is scaled back where it would store more than ``bent`` twice.
    """
    values, point, middle, inside = work.values, work.point, work.middle, held[3]
    for i in range(len(y)):
        middle[i] = y[i] + 0.5 * dt * velocity[i]
    to_ball(middle, point)
    most = max(tables.inner_give.shape[1], tables.stiffness_root.shape[1])
    fill_monomials(point, tables.parent, tables.variable, values[:most])
    fill_give(tables, values, inside)
    if tables.scales[2] > 0.0:
        fill_metric((tables.stiffness_root, tables.stiffness_factor), values, work, held[1])
    now = stored_in(inner[0], inside.give)
    if now > bent:
        for k in range(inner.shape[1]):
            inner[0, k] *= math.sqrt(bent / now)


@nb.njit(cache=True)
def run_kernel(
    y: np.ndarray,
    velocity: np.ndarray,
    inner: np.ndarray,
    rest: np.ndarray,
    dt: float,
    load: np.ndarray,
    tables: Any,
    hooks: Any,
    path: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
) -> tuple[int, float, tuple[float, float, float]]:
    """Advance ``y``, ``velocity`` (r,) and ``inner`` (2, 6) by implicit Euler over ``load`` (steps, r) Pa and N.

    The amplitudes are taken where the step's first iteration leads, viscosity half way there, see ``inertia.py`` and
    ``viscosity.py``. That iteration goes by what the last steps foretell (``past.py``); where the next one goes far they are
    taken where that leads. ``velocity`` is the last step's way by ``dt``; after a step it is scaled down where the kinetic energy
    would grow by more than the forces' work. ``inner``, by which the inside gives to acceleration (``pod.step.inside``), is
    scaled down where it would gain energy.

    Parameters
    ----------
    rest : (r,) where strains of effects count from
    path : (steps, r), filled with y, or (0, r) to skip
    position, quaternion : (steps, 3) m, (steps, 4), filled, or of zero rows

    Returns
    -------
    failed : number of steps that did not converge
    farthest : largest ``|y|``; above 1 the model has no samples
    felt : m/s^2, the gravity that acted in the last step, which effects may turn
    """
    r, n = len(y), len(y) - 3
    work = make_room(tables)
    values, point, scratch = work.values, work.point, work.scratch
    inertia, right, start, ahead = np.empty((r, r)), np.empty(r), np.empty(r), np.empty(r)
    gradient, hessian, jacobian = np.empty(r), np.empty((r, r)), np.empty((r, r))
    direction, trial, progress = np.empty(r), np.empty(r), np.empty(2)
    course = make_course(r, len(tables.amplitudes), ())
    held = (np.empty((r, r)), np.zeros((r, r)), np.zeros(r), make_inside(r, ()), course)
    ports, bare, past = make_ports(n), np.empty(r), make_past(r)
    felt = ports.load[GRAVITY]
    felt[:] = tables.gravity
    with_effects = len(hooks[0].kernels) + len(hooks[1].kernels) > 0
    close, failed = CLOSE if with_effects else NEAR, 0
    if with_effects:
        fill_potential(rest, tables, work, gradient, hessian)
        fill_elastic(gradient, tables, values, ports)
        ports.settled[:] = ports.elastic
        ports.elastic[:] = 0.0
        fill_potential(y, tables, work, gradient, hessian)
        fill_ports(y, rest, gradient, hessian, dt, load[0, :n], tables, ports, True)
        go_on(ports)
    fill_amplitudes(y - dt * velocity, 0, False, tables, work, course.before, course.spare)
    _look_back(y, dt * velocity, tables, work, held, past, trial, gradient, hessian)
    farthest = to_ball(y, point)
    course.now[:] = course.ahead
    kinetic = kinetic_energy(velocity, inner, dt, held)
    _set_out(y, velocity, inner, np.inf, dt, tables, work, held)
    for step in range(len(load)):
        pressure = load[step, :n]
        start[:] = y
        begin_step(velocity, inner, load[step], dt, tables, held, start, ahead, inertia, right)
        y[:] = ahead
        progress[0] = -1.0
        longest = np.inf
        for iteration in range(MAX_ITERATIONS):
            if iteration == 0:
                foretell_potential(past, y, gradient, hessian)
                if with_effects:
                    to_ball(y, point)
                    fill_monomials(point, tables.parent, tables.variable, values[: tables.weight.shape[2]])
            else:
                if iteration == 1 or (iteration == 2 and longest >= NEAR):
                    fill_resistance(start, y - start, tables, work, held)
                    begin_step(velocity, inner, load[step], dt, tables, held, start, ahead, inertia, right)
                    progress[0] = -1.0
                fill_potential(y, tables, work, gradient, hessian)
                keep(past, y, gradient, hessian)
            for i in range(r):
                for j in range(r):
                    jacobian[i, j] = hessian[i, j] + inertia[i, j]
            if with_effects:
                bare[:] = gradient
                add_effects(
                    y, rest, gradient, hessian, dt, pressure, tables, hooks, ports, values, jacobian, iteration == 0
                )
            longest = iterate(
                y, gradient, jacobian, inertia, right, tables, not with_effects, scratch, direction, trial, progress
            )
            if longest < close and iteration > 0:
                break
        if longest >= close:
            failed += 1
        if with_effects:  # the potential's derivatives are those a last, negligible step ago
            commit_effects(y, rest, bare, hessian, dt, pressure, tables, hooks, ports, values)
        kinetic, bent = end_step(y, velocity, inner, dt, tables, work, held, start, kinetic)
        _set_out(y, velocity, inner, bent, dt, tables, work, held)
        farthest = max(farthest, to_ball(y, point))
        if len(path) > 0:
            path[step] = y
        if len(position) > 0:
            tip_pose(y, inner[0], felt, tables, values, point, position[step], quaternion[step])
    return failed, farthest, (felt[0], felt[1], felt[2])
