"""The energy ROM compiled: implicit Euler with effects inside the step."""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.pod.inside import (
    AXES,
    begin_inside,
    end_inside,
    fill_give,
    fill_mass,
    make_inside,
    shared_energy,
    stored_in,
)
from softrl.pod.linear import newton_direction
from softrl.pod.ports import add_effects, commit_effects, fill_ports, make_ports
from softrl.pod.pose import tip_pose
from softrl.pod.potential import (
    FAST,
    fill_monomials,
    fill_potential,
    fill_rows,
    fill_square,
    square_of,
    to_ball,
)
from softrl.pod.viscosity import fill_viscosity

TOLERANCE = 1e-9  # change of y: below a nanometre at the tip
CLOSE = 1e-6  # likewise where the Jacobian is exact: such a step leaves an error that is far below TOLERANCE
MAX_ITERATIONS = 60
LONGEST_STEP = 0.5  # of y, in one iteration
AGAIN = 3  # times that a velocity is scaled to its energy, each with the mass where the last leads: enough for 1e-6


@nb.njit(cache=True, fastmath=FAST)
def _fill_turning(
    radius: float, velocity: np.ndarray, point: np.ndarray, root: np.ndarray, slope: np.ndarray, scratch: np.ndarray,
    force: np.ndarray,
) -> None:
    """Fill ``force`` (r,) with that of inertia at constant ``velocity``: grad(v'M v) / 2 - M' v, M = R'R.

    ``root`` (r r,) and ``slope`` (r r r,) are R and its gradient at ``point``, the image in the unit ball of a state at
    ``radius``.
    """
    r = len(velocity)
    beyond = radius > 1.0
    moved, changed, turned, along = scratch[0], scratch[1], scratch[2], scratch[3]
    outward = inward = 0.0
    for i in range(r):
        outward += point[i] * velocity[i] if beyond else 0.0
    for a in range(r):
        total = 0.0
        for i in range(r):
            total += root[a * r + i] * velocity[i]
        moved[a], changed[a], force[a] = total, 0.0, 0.0
        along[a] = (velocity[a] - point[a] * outward) / radius if beyond else velocity[a]
    for j in range(r):
        turn = 0.0
        for a in range(r):
            total, row, share = 0.0, (j * r + a) * r, along[j] * moved[a]
            for i in range(r):
                total += slope[row + i] * velocity[i]
                force[i] -= share * slope[row + i]
            changed[a] += along[j] * total
            turn += total * moved[a]
        turned[j] = turn
        inward += point[j] * turn if beyond else 0.0
    for j in range(r):
        total = force[j] + ((turned[j] - point[j] * inward) / radius if beyond else turned[j])
        for a in range(r):
            total -= root[a * r + j] * changed[a]
        force[j] = total


@nb.njit(cache=True, fastmath=FAST)
def begin_step(
    velocity: np.ndarray, inner: np.ndarray, load: np.ndarray, dt: float, tables: Any, held: Any, start: np.ndarray,
    ahead: np.ndarray, inertia: np.ndarray, right: np.ndarray,
) -> None:
    """Fill what is constant in a step from ``start``: ``inertia`` (r, r) y - ``right`` (r,), and free flight ``ahead``.

    ``held`` are mass and viscosity (r, r), the forces of turning and of viscosity's slope (r,), and the ``pod.inside``.
    """
    mass, stiff, turning, steep, inside = held
    r, mass_scale = len(start), tables.scales[0]
    free, drag, late = mass_scale / dt**2, tables.scales[1] / dt, tables.scales[2] / dt
    for i in range(r):
        ahead[i] = start[i] + dt * velocity[i]
    for i in range(r):
        total = mass_scale * turning[i] - late * steep[i]
        for k in range(r):
            total += tables.frame[k, i] * load[k]
        for j in range(r):
            damping = drag * mass[i, j] + late * stiff[i, j]
            inertia[i, j] = free * mass[i, j] + damping
            total += free * mass[i, j] * ahead[j] + damping * start[j]
        right[i] = total
    begin_inside(inner, ahead, start, dt, tables, inside, inertia, right)


@nb.njit(cache=True)
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


@nb.njit(cache=True)
def end_step(
    y: np.ndarray, velocity: np.ndarray, inner: np.ndarray, dt: float, tables: Any, held: Any, start: np.ndarray
) -> tuple[float, float]:
    """Bring ``velocity`` and ``inner`` up to date; return the energies by which ``_set_out`` scales them.

    They are twice the kinetic energy and twice what the inside stores. Neither the force of turning nor the change of mass
    may alter the first; nor may the second grow as stiffness changes.
    """
    mass, _, turning, _, inside = held
    r = len(y)
    for i in range(r):
        velocity[i] = (y[i] - start[i]) / dt
    bent = end_inside(inner, y, dt, inside)
    kinetic = square_of(mass, velocity) + shared_energy(velocity, inner, inside)
    for i in range(r):
        kinetic -= 2.0 * dt * turning[i] * velocity[i]
    return max(kinetic, 0.0), bent


@nb.njit(cache=True)
def share_of(energy: float, now: float) -> float:
    """Return the factor that brings what has the energy ``now`` to ``energy``; 1 for what has none."""
    return math.sqrt(energy / now) if now > 0.0 else 1.0


@nb.njit(cache=True)
def _set_out(
    y: np.ndarray, velocity: np.ndarray, inner: np.ndarray, dt: float, energies: tuple[float, float], tables: Any,
    work: Any, held: Any,
) -> float:
    """Fill what is held during the step from ``y``, and scale what moves to its energies; return ``|y|``.

    Parameters
    ----------
    energies : twice the kinetic energy that the rates are scaled to, negative to leave them; the inside is scaled down
        where it would store more than the other
    work : monomials, point (r,), two matrices (r, r), a vector (r,), rows (r r,), (r r r,), (pairs,), a polynomial
    held : as for ``begin_step``
    """
    values, point, scratch, _, ahead, root, slope, _, _ = work
    mass, _, turning, _, inside = held
    kinetic, bent = energies
    radius = to_ball(y, point)
    few, beyond = values[: max(tables.mass_root.shape[1], tables.give_root.shape[1], tables.give.shape[1])], 0.0
    for _ in range(AGAIN if kinetic >= 0.0 else 1):  # the mass ahead hangs on the scaled velocity
        for i in range(len(y)):
            ahead[i] = y[i] + dt * velocity[i]
        beyond = to_ball(ahead, point)
        fill_monomials(point, tables.parent, tables.variable, few)
        fill_rows(tables.mass_root, few, root)
        fill_square(root, mass)
        fill_mass(root, tables, few, inside)
        if kinetic >= 0.0:
            share = share_of(kinetic, square_of(mass, velocity) + shared_energy(velocity, inner, inside))
            for i in range(len(y)):
                velocity[i] *= share
            for k in range(AXES):
                inner[1, k] *= share
    fill_rows(tables.mass_slope, few, slope)
    fill_give(tables, few, inside)
    share = min(1.0, share_of(bent, stored_in(inner[0], inside.give)))
    for k in range(AXES):
        inner[0, k] *= share
    _fill_turning(beyond, velocity, point, root, slope, scratch, turning)
    if tables.scales[2] > 0.0:
        fill_viscosity(y, dt * velocity, tables, work, held)
    return radius


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
) -> tuple[int, float]:
    """Advance ``y``, ``velocity`` (r,) and ``inner`` (2, 3) by implicit Euler over ``load`` (steps, r) Pa and N.

    Mass is that where the velocity leads in a step, and so is the force of inertia by which a turning body leaves the
    straight way. Viscosity is that half way to where the step's first iteration leads, see ``pod.viscosity``. After a
    step the velocity is scaled so that neither the force of turning nor the change of mass alters the kinetic energy:
    energy is created nowhere. ``inner``, by which the inside gives to acceleration (``pod.inside``), is scaled down where
    it would gain energy.

    Parameters
    ----------
    rest : (r,) where strains of effects count from
    path : (steps, r), filled with y, or (0, r) to skip
    position, quaternion : (steps, 3) m, (steps, 4), filled, or of zero rows

    Returns
    -------
    failed : number of steps that did not converge
    farthest : largest ``|y|``; above 1 the model has no samples
    """
    r, n = len(y), len(y) - 3
    values, point = np.empty(len(tables.parent)), np.empty(r)
    mass, stiff, factor = np.zeros((r, r)), np.zeros((r, r)), np.zeros((r, r))
    inertia, right, start, ahead = np.empty((r, r)), np.empty(r), np.empty(r), np.empty(r)
    gradient, hessian, jacobian, scratch = np.empty(r), np.empty((r, r)), np.empty((r, r)), np.empty((r, r))
    direction, trial, progress = np.empty(r), np.empty(r), np.empty(2)
    rows = np.empty(r * r), np.empty(r * r * r), np.empty(len(tables.elastic))
    mixed = np.empty(max(tables.elastic.shape[1], tables.stiffness_root.shape[1]))
    ports, bare = make_ports(n), np.empty(r)
    with_effects = len(hooks[0]) + len(hooks[3]) > 0
    close, viscous = TOLERANCE if with_effects else CLOSE, tables.scales[2] > 0.0
    failed = 0
    if with_effects:
        fill_potential(y, tables, values, point, gradient, hessian)
        fill_ports(y, rest, gradient, hessian, dt, load[0, :n], tables, ports, True)
        ports.strains[0], ports.tips[0] = ports.strains[1], ports.tips[1]
    work = (values, point, scratch, factor, direction, rows[0], rows[1], rows[2], mixed)
    held = (mass, stiff, np.empty(r), np.zeros(r), make_inside(r, ()))
    farthest = _set_out(y, velocity, inner, dt, (-1.0, np.inf), tables, work, held)
    for step in range(len(load)):
        pressure = load[step, :n]
        start[:] = y
        begin_step(velocity, inner, load[step], dt, tables, held, start, ahead, inertia, right)
        y[:] = ahead
        progress[0] = -1.0
        longest = np.inf
        for iteration in range(MAX_ITERATIONS):
            if iteration == 1 and viscous:
                fill_viscosity(start, y - start, tables, work, held)
                begin_step(velocity, inner, load[step], dt, tables, held, start, ahead, inertia, right)
                progress[0] = -1.0
            fill_potential(y, tables, values, point, gradient, hessian)
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
            if longest < close and (iteration > 0 or not viscous):
                break
        if longest >= close:
            failed += 1
        if with_effects:  # the potential's derivatives are those a last, negligible step ago
            commit_effects(y, rest, bare, hessian, dt, pressure, tables, hooks, ports)
        energies = end_step(y, velocity, inner, dt, tables, held, start)
        farthest = max(farthest, _set_out(y, velocity, inner, dt, energies, tables, work, held))
        if len(path) > 0:
            path[step] = y
        if len(position) > 0:
            tip_pose(y, inner[0], tables, values, point, position[step], quaternion[step])
    return failed, farthest
