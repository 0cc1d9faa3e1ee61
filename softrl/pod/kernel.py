"""The energy ROM compiled: implicit Euler with effects inside the step, tip pose."""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.pod.linear import newton_direction
from softrl.pod.ports import add_effects, commit_effects, fill_ports, make_ports
from softrl.pod.potential import (
    fill_behind,
    fill_elastic_factor,
    fill_monomials,
    fill_potential,
    fill_root,
    fill_square,
    polynomial,
    to_ball,
)

TOLERANCE = 1e-9  # change of y: below a nanometre at the tip
MAX_ITERATIONS = 60
LONGEST_STEP = 0.5  # of y, in one iteration



@nb.njit(cache=True)
def tip_pose(
    y: np.ndarray,
    lag: np.ndarray,
    tables: Any,
    values: np.ndarray,
    point: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
) -> None:
    """Fill the tip's position (3,) m and quaternion (4,) w x y z at ``y`` and lagged rate ``lag`` (r,)."""
    n, r = len(y) - 3, len(y)
    beyond = max(to_ball(y, point) - 1.0, 0.0)
    few = values[: max(tables.rotation.shape[1], tables.lag_rotation.shape[1])]
    fill_monomials(point, tables.parent, tables.variable, few)
    square = lagged = 0.0
    for k in range(3):
        position[k] = tables.rest_tip[k]
        for j in range(r):
            position[k] += tables.frame[n + k, j] * y[j]
        angle = 0.0
        for m in range(tables.rotation.shape[1]):
            angle += tables.rotation[k, m] * few[m] * (1.0 + beyond * tables.degrees[m])
        quaternion[1 + k] = angle
        square += angle * angle
    half = 0.5 * math.sqrt(square)
    factor = 0.5 if half < 1e-9 else math.sin(half) / (2.0 * half)
    quaternion[0] = math.cos(half)
    for k in range(3):
        quaternion[1 + k] *= factor
    if tables.lag_rotation.shape[1] == 0:
        return
    w, a, b, c = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    turn = (0.0, 0.0, 0.0)
    for k in range(3):
        angle = 0.0
        for j in range(r):
            angle += polynomial(tables.lag_rotation[k * r + j], few) * lag[j]
        angle *= 0.5 * tables.scales[5]
        lagged += angle * angle
        turn = (turn[1], turn[2], angle)
    v, (x, y_, z) = 1.0 / math.sqrt(1.0 + lagged), turn
    quaternion[0] = v * (w - x * a - y_ * b - z * c)
    quaternion[1] = v * (a + x * w + y_ * c - z * b)
    quaternion[2] = v * (b + y_ * w + z * a - x * c)
    quaternion[3] = v * (c + z * w + x * b - y_ * a)


@nb.njit(cache=True)
def _fill_mass(
    y: np.ndarray, tables: Any, values: np.ndarray, point: np.ndarray, root: np.ndarray, mass: np.ndarray
) -> float:
    """Fill mass and its root (r, r) at ``y``; return ``|y|``."""
    radius = to_ball(y, point)
    few = values[: tables.mass_root.shape[1]]
    fill_monomials(point, tables.parent, tables.variable, few)
    fill_root(tables.mass_root, few, root)
    fill_square(root, mass)
    return radius


@nb.njit(cache=True)
def _fill_viscosity(
    y: np.ndarray,
    tables: Any,
    values: np.ndarray,
    point: np.ndarray,
    root: np.ndarray,
    factor: np.ndarray,
    product: np.ndarray,
    stiff: np.ndarray,
    loose: np.ndarray,
) -> None:
    """Fill viscosity and its lagging share (r, r) at ``y``."""
    to_ball(y, point)
    few = values[: max(tables.elastic.shape[1], tables.stiffness_root.shape[1], tables.lag_root.shape[1])]
    fill_monomials(point, tables.parent, tables.variable, few)
    fill_elastic_factor(tables, few, factor)
    fill_root(tables.stiffness_root, few, root)
    fill_behind(root, factor, product)
    fill_square(product, stiff)
    if tables.lag_root.shape[1] > 0:
        fill_root(tables.lag_root, few, root)
        fill_behind(root, factor, product)
        fill_square(product, loose)


@nb.njit(cache=True)
def _fill_turning(
    radius: float,
    velocity: np.ndarray,
    tables: Any,
    values: np.ndarray,
    point: np.ndarray,
    root: np.ndarray,
    scratch: np.ndarray,
    force: np.ndarray,
) -> None:
    """Fill ``force`` (r,) with that of inertia at constant ``velocity``: grad(v'M v) / 2 - M' v, M = R'R.

    ``values`` are the monomials and ``root`` is R at ``point``, the image of a state at ``radius`` in the unit ball.
    """
    r = len(velocity)
    force[:] = 0.0
    if tables.mass_slope.shape[1] == 0:
        return
    few = values[: tables.mass_slope.shape[1]]
    outward = 0.0
    if radius > 1.0:
        for i in range(r):
            outward += point[i] * velocity[i]
    moved, changed = scratch[0], scratch[1]
    for a in range(r):
        moved[a] = changed[a] = 0.0
        for i in range(r):
            moved[a] += root[a, i] * velocity[i]
    for j in range(r):
        along = velocity[j] if radius <= 1.0 else (velocity[j] - point[j] * outward) / radius
        for a in range(r):
            turned = 0.0
            for i in range(r):
                slope = polynomial(tables.mass_slope[(j * r + a) * r + i], few)
                turned += slope * velocity[i]
                force[i] -= along * slope * moved[a]
            changed[a] += along * turned
            scratch[2, j] = turned * moved[a] + (scratch[2, j] if a > 0 else 0.0)
    inward = 0.0
    if radius > 1.0:
        for j in range(r):
            inward += point[j] * scratch[2, j]
    for j in range(r):
        force[j] += scratch[2, j] if radius <= 1.0 else (scratch[2, j] - point[j] * inward) / radius
        for a in range(r):
            force[j] -= root[a, j] * changed[a]


@nb.njit(cache=True)
def _square(matrix: np.ndarray, vector: np.ndarray) -> float:
    """Return vector' matrix vector."""
    total = 0.0
    for i in range(len(vector)):
        for j in range(len(vector)):
            total += vector[i] * matrix[i, j] * vector[j]
    return total


@nb.njit(cache=True)
def _set_out(
    y: np.ndarray,
    velocity: np.ndarray,
    lag: np.ndarray,
    dt: float,
    kinetic: float,
    stored: float,
    tables: Any,
    work: Any,
    held: Any,
) -> float:
    """Fill what is held during the step from ``y``, and scale velocity and lag to their energies; return ``|y|``.

    Parameters
    ----------
    kinetic : twice the kinetic energy that the velocity is scaled to; negative to leave it
    stored : the lag is scaled down where it would hold more, in the measure of ``loose``
    work : monomials, point (r,), three matrices (r, r), a vector (r,)
    held : mass, viscosity, its lagging share (r, r), force of turning (r,)
    """
    values, point, root, scratch, factor, halfway = work
    mass, stiff, loose, turning = held
    r = len(y)
    radius = _fill_mass(y, tables, values, point, root, mass)
    if kinetic >= 0.0:
        now = _square(mass, velocity)
        share = math.sqrt(kinetic / now) if now > 0.0 else 1.0
        for i in range(r):
            velocity[i] *= share
    _fill_turning(radius, velocity, tables, values, point, root, scratch, turning)
    if tables.scales[2] > 0.0:
        for i in range(r):
            halfway[i] = y[i] + 0.5 * dt * velocity[i]
        _fill_viscosity(halfway, tables, values, point, root, factor, scratch, stiff, loose)
        after = _square(loose, lag)
        if after > stored:
            for i in range(r):
                lag[i] *= math.sqrt(stored / after)
    return radius


@nb.njit(cache=True)
def run_kernel(
    y: np.ndarray,
    velocity: np.ndarray,
    lag: np.ndarray,
    rest: np.ndarray,
    dt: float,
    load: np.ndarray,
    tables: Any,
    hooks: Any,
    path: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
) -> tuple[int, float]:
    """Advance ``y``, ``velocity`` and ``lag`` (r,) in place by implicit Euler over every row of ``load`` (steps, r) Pa and N.

    Mass is that at the start of a step, and so is the force of inertia by which a turning body leaves the straight way;
    viscosity is that half a step ahead, as in the full model. After a step the velocity is scaled so that neither that
    force nor the change of mass alters the kinetic energy: energy is created nowhere. A share of the viscosity lags: it
    acts on ``lag``, the rate as the body's inside follows it, ``tau d lag/dt = rate - lag``, and ``lag`` is scaled down
    where it would gain energy.

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
    mass, stiff, loose, root = np.zeros((r, r)), np.zeros((r, r)), np.zeros((r, r)), np.zeros((r, r))
    inertia, right, start = np.empty((r, r)), np.empty(r), np.empty(r)
    gradient, hessian, jacobian, scratch = np.empty(r), np.empty((r, r)), np.empty((r, r)), np.empty((r, r))
    direction, trial, pressure = np.empty(r), np.empty(r), np.empty(n)
    turning = np.empty(r)
    ports, bare = make_ports(n), np.empty(r)
    with_effects = len(hooks[0]) + len(hooks[3]) > 0
    mass_scale, mass_damping, stiffness_damping = tables.scales[0], tables.scales[1], tables.scales[2]
    with_lag = stiffness_damping > 0.0 and tables.lag_root.shape[1] > 0
    hold = tables.scales[4] / (tables.scales[4] + dt) if with_lag else 0.0
    failed, farthest = 0, 0.0
    if with_effects:
        fill_potential(y, tables, values, point, gradient, hessian)
        fill_ports(y, rest, gradient, hessian, dt, load[0, :n], tables, ports, True)
        ports.strains[0], ports.tips[0] = ports.strains[1], ports.tips[1]
    work = (values, point, root, scratch, jacobian, direction)
    held = (mass, stiff, loose, turning)
    farthest = _set_out(y, velocity, lag, dt, -1.0, np.inf, tables, work, held)
    for step in range(len(load)):
        for i in range(n):
            pressure[i] = load[step, i]
        for i in range(r):
            start[i] = y[i]
            right[i] = mass_scale * turning[i]
            for k in range(r):
                right[i] += tables.frame[k, i] * load[step, k]
        for i in range(r):
            for j in range(r):
                free = mass_scale * mass[i, j] / dt**2
                drag = (mass_damping * mass[i, j] + stiffness_damping * stiff[i, j]) / dt
                if with_lag:
                    drag += stiffness_damping * (1.0 - hold) * loose[i, j] / dt
                    right[i] -= stiffness_damping * hold * loose[i, j] * lag[j]
                inertia[i, j] = free + drag
                right[i] += free * (start[j] + dt * velocity[j]) + drag * start[j]
        for i in range(r):
            y[i] = start[i] + dt * velocity[i]
        done, before, share = False, np.inf, 1.0
        for iteration in range(MAX_ITERATIONS):
            fill_potential(y, tables, values, point, gradient, hessian)
            for i in range(r):
                for j in range(r):
                    jacobian[i, j] = hessian[i, j] + inertia[i, j]
            if with_effects:
                bare[:] = gradient
                add_effects(
                    y, rest, gradient, hessian, dt, pressure, tables, hooks, ports, values, jacobian, iteration == 0
                )
            along = 0.0
            for i in range(r):
                gradient[i] -= right[i]
                for j in range(r):
                    gradient[i] += inertia[i, j] * y[j]
                along += gradient[i] * direction[i] if iteration > 0 else 0.0
            # the last step went too far if the slope along it has turned round: go back by half
            if iteration > 0 and along < -0.9 * before and share > 0.01:
                share *= 0.5
                for i in range(r):
                    y[i] = trial[i] - share * direction[i]
                continue
            newton_direction(jacobian, tables.quadratic, gradient, not with_effects, scratch, direction)
            longest = before = 0.0
            for i in range(r):
                longest = max(longest, abs(direction[i]))
                before += gradient[i] * direction[i]
            before = abs(before)
            share = 1.0 if longest < LONGEST_STEP else LONGEST_STEP / longest
            for i in range(r):
                trial[i] = y[i]
                y[i] -= share * direction[i]
            if longest < TOLERANCE:
                done = True
                break
        if not done:
            failed += 1
        if with_effects:  # the potential's derivatives are those a last, negligible step ago
            commit_effects(y, rest, bare, hessian, dt, pressure, tables, hooks, ports)
        for i in range(r):
            velocity[i] = (y[i] - start[i]) / dt
            lag[i] = hold * lag[i] + (1.0 - hold) * velocity[i] if with_lag else 0.0
        kinetic, stored = _square(mass, velocity), _square(loose, lag)
        for i in range(r):
            kinetic -= 2.0 * dt * turning[i] * velocity[i]
        farthest = max(farthest, _set_out(y, velocity, lag, dt, max(kinetic, 0.0), stored, tables, work, held))
        if len(path) > 0:
            path[step] = y
        if len(position) > 0:
            tip_pose(y, lag, tables, values, point, position[step], quaternion[step])
    return failed, farthest
