"""The energy ROM compiled: implicit Euler with effects inside the step, tip pose."""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.pod.linear import newton_direction
from softrl.pod.ports import add_effects, commit_effects, fill_ports, make_ports
from softrl.pod.potential import fill_monomials, fill_potential, fill_square, polynomial, to_ball

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
def _fill_operators(
    y: np.ndarray,
    tables: Any,
    values: np.ndarray,
    point: np.ndarray,
    root: np.ndarray,
    mass: np.ndarray,
    stiff: np.ndarray,
    loose: np.ndarray,
) -> float:
    """Fill mass, viscosity and its lagging share (r, r) at ``y``; return ``|y|``."""
    radius = to_ball(y, point)
    viscous = tables.scales[2] > 0.0
    count = tables.mass_root.shape[1]
    if viscous:
        count = max(count, tables.stiffness_root.shape[1], tables.lag_root.shape[1])
    few = values[:count]
    fill_monomials(point, tables.parent, tables.variable, few)
    fill_square(tables.mass_root, few, root, mass)
    if viscous:
        fill_square(tables.stiffness_root, few, root, stiff)
        if tables.lag_root.shape[1] > 0:
            fill_square(tables.lag_root, few, root, loose)
    return radius


@nb.njit(cache=True)
def _square(matrix: np.ndarray, vector: np.ndarray) -> float:
    """Return vector' matrix vector."""
    total = 0.0
    for i in range(len(vector)):
        for j in range(len(vector)):
            total += vector[i] * matrix[i, j] * vector[j]
    return total


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

    Mass and damping are those at the start of a step. After it the velocity is scaled so that the kinetic energy is
    unchanged by the change of mass: energy is created nowhere. A share of the viscosity lags: it acts on ``lag``, the
    rate as the body's inside follows it, ``tau d lag/dt = rate - lag``, and ``lag`` is scaled down where it would gain
    energy.

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
    farthest = max(farthest, _fill_operators(y, tables, values, point, root, mass, stiff, loose))
    for step in range(len(load)):
        for i in range(n):
            pressure[i] = load[step, i]
        for i in range(r):
            start[i] = y[i]
            right[i] = 0.0
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
        farthest = max(farthest, _fill_operators(y, tables, values, point, root, mass, stiff, loose))
        now, held = _square(mass, velocity), _square(loose, lag)
        factor = math.sqrt(kinetic / now) if now > 0.0 else 1.0
        loss = math.sqrt(stored / held) if held > stored else 1.0
        for i in range(r):
            velocity[i] *= factor
            lag[i] *= loss
        if len(path) > 0:
            path[step] = y
        if len(position) > 0:
            tip_pose(y, lag, tables, values, point, position[step], quaternion[step])
    return failed, farthest
