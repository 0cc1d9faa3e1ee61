"""The energy ROM compiled: potential, implicit Euler with effects inside the step, tip pose.

Unknowns are ``y`` with ``z = frame y``. The samples of the model lie in the ball ``|y| <= 1``; outside it the potential
goes on along rays from the origin as its Taylor polynomial of second order at the sphere, and a wall rises,
``wall (|y| - 1)^3``: twice differentiable, and the wall outgrows the rest, so that nothing runs away and the potential
is convex far out. A part P_d of degree d becomes ``w_d(|y|) P_d(y / |y|)``,
``w_d(r) = 1 + d (r - 1) + d (d - 1) (r - 1)^2 / 2``; degrees up to two go on unchanged.
"""

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.effects.effect import (
    ADDED,
    ADDED_SLOPE,
    BODY_PORT_ROWS,
    ELASTIC,
    ELASTIC_SLOPE,
    FORCE,
    FORCE_SLOPE,
    GRAVITY,
    LOAD_PORT_ROWS,
    PRESSURE,
    RATE,
    REST,
    STRAIN,
    TIP,
    TIP_VELOCITY,
)

TOLERANCE = 1e-9  # change of y: below a nanometre at the tip
MAX_ITERATIONS = 60
LONGEST_STEP = 0.5  # of y, in one iteration
PROBE = 1e-4  # of the stiffness scale: change of the elastic pressure by which effects are probed
_FAST = {"reassoc", "contract"}


class Tables(NamedTuple):
    """The arrays that the kernels read; ``r = n + 3`` coordinates, k monomials (a count of its own for each map).

    Attributes
    ----------
    frame, inverse : (r, r) z per y and y per z
    parent, variable, degrees : (k,) how monomials are made
    gradient : (r, k), hessian : (pairs, k) J, of elastic energy and weight together
    quadratic : (r, r) J, elastic Hessian at rest: what makes an indefinite Newton matrix definite
    mass_root, stiffness_root : (r r, k)
    weight : (3, r, k) N/(m/s^2) m, mass times the gradient of the centre of mass by y
    rotation : (3, k) rad
    rest_volume : (n,) m^3;  rest_tip : (3,) m
    rest_slope : (n,) Pa, pressure per relative volume of one chamber at rest, other volumes held and tip free
    gravity : (3,) m/s^2, contained in gradient and hessian
    scales : (4,) mass scale; mass damping 1/s; stiffness damping s; wall J
    """

    frame: np.ndarray
    inverse: np.ndarray
    parent: np.ndarray
    variable: np.ndarray
    degrees: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    quadratic: np.ndarray
    mass_root: np.ndarray
    stiffness_root: np.ndarray
    weight: np.ndarray
    rotation: np.ndarray
    rest_volume: np.ndarray
    rest_tip: np.ndarray
    rest_slope: np.ndarray
    gravity: np.ndarray
    scales: np.ndarray


@nb.njit(cache=True)
def fill_monomials(point: np.ndarray, parent: np.ndarray, variable: np.ndarray, values: np.ndarray) -> None:
    """Fill ``values`` with the monomials at ``point``."""
    values[0] = 1.0
    for k in range(1, len(values)):
        values[k] = values[parent[k]] * point[variable[k]]


@nb.njit(cache=True)
def to_ball(y: np.ndarray, point: np.ndarray) -> float:
    """Fill ``point`` with the nearest point of the unit ball on the ray to ``y``; return ``|y|``."""
    square = 0.0
    for i in range(len(y)):
        square += y[i] * y[i]
    radius = math.sqrt(square)
    shrink = 1.0 if radius <= 1.0 else 1.0 / radius
    for i in range(len(y)):
        point[i] = y[i] * shrink
    return radius


@nb.njit(cache=True, fastmath=_FAST)
def polynomial(coefficients: np.ndarray, values: np.ndarray) -> float:
    """Return one polynomial at monomials ``values``, of which it reads as many as it has coefficients."""
    total = 0.0
    for k in range(len(coefficients)):
        total += coefficients[k] * values[k]
    return total


@nb.njit(cache=True)
def fill_potential(
    y: np.ndarray, tables: Any, values: np.ndarray, point: np.ndarray, gradient: np.ndarray, hessian: np.ndarray
) -> float:
    """Fill gradient (r,) and Hessian (r, r) of the potential at ``y`` in J; return ``|y|``."""
    r = len(y)
    radius = to_ball(y, point)
    fill_monomials(point, tables.parent, tables.variable, values)
    for i in range(r):
        gradient[i] = polynomial(tables.gradient[i], values)
    pair = 0
    for i in range(r):
        for j in range(i, r):
            hessian[i, j] = polynomial(tables.hessian[pair], values)
            hessian[j, i] = hessian[i, j]
            pair += 1
    if radius > 1.0:
        _continue(radius, tables, values, point, gradient, hessian)
    return radius


@nb.njit(cache=True)
def _continue(
    radius: float, tables: Any, values: np.ndarray, u: np.ndarray, gradient: np.ndarray, hessian: np.ndarray
) -> None:
    """Turn the derivatives at the sphere's point ``u`` into those at ``radius u``.

    With P_d of degree d, ``f_d(r) = w_d(r) / r^d`` and ``sum f_d(|y|) P_d(y)`` the potential outside; P_d and its
    gradient are tied by ``u.P_d' = d P_d``.
    """
    r, terms = len(u), tables.gradient.shape[1]
    second = tables.hessian.shape[1]
    weighed = np.empty((3, terms))
    for k in range(terms):
        d = tables.degrees[k] + 1.0
        value, slope, bend = _ray(d, radius)
        first = slope - d * value / radius
        weighed[0, k] = value / radius * values[k]
        weighed[1, k] = first * values[k]
        weighed[2, k] = (bend - 2.0 * d * slope / radius + d * (d + 1.0) * value / radius**2) / d * values[k]
    curved = np.empty(second)
    for k in range(second):
        value, _, _ = _ray(tables.degrees[k] + 2.0, radius)
        curved[k] = value / radius**2 * values[k]
    side = np.empty(r)
    along = bending = 0.0
    for i in range(r):
        side[i] = polynomial(tables.gradient[i], weighed[1]) / radius
        bending += u[i] * polynomial(tables.gradient[i], weighed[2])
        gradient[i] = polynomial(tables.gradient[i], weighed[0])
    for k in range(terms):
        weighed[1, k] /= tables.degrees[k] + 1.0
    for i in range(r):
        along += u[i] * polynomial(tables.gradient[i], weighed[1])
    for i in range(r):
        gradient[i] += along * u[i]
    pair = 0
    for i in range(r):
        for j in range(i, r):
            hessian[i, j] = (
                polynomial(tables.hessian[pair], curved)
                + side[i] * u[j]
                + u[i] * side[j]
                + (bending - along / radius) * u[i] * u[j]
                + (along / radius if i == j else 0.0)
            )
            hessian[j, i] = hessian[i, j]
            pair += 1
    wall, beyond = 3.0 * tables.scales[3], radius - 1.0
    for i in range(r):
        gradient[i] += wall * beyond**2 * u[i]
        hessian[i, i] += wall * beyond**2 / radius
        for j in range(r):
            hessian[i, j] += wall * beyond * (2.0 - beyond / radius) * u[i] * u[j]


@nb.njit(cache=True)
def _ray(degree: float, radius: float) -> tuple[float, float, float]:
    """Return w_d and its two derivatives at ``radius``."""
    beyond, bend = radius - 1.0, degree * (degree - 1.0)
    return 1.0 + beyond * (degree + 0.5 * bend * beyond), degree + bend * beyond, bend


@nb.njit(cache=True, fastmath=_FAST)
def fill_square(roots: np.ndarray, values: np.ndarray, root: np.ndarray, square: np.ndarray) -> None:
    """Fill ``square`` (r, r) with R' R, R from the polynomials ``roots`` (r r, k): never indefinite."""
    r = len(root)
    for i in range(r):
        for j in range(r):
            root[i, j] = polynomial(roots[i * r + j], values)
    for i in range(r):
        for j in range(i, r):
            total = 0.0
            for k in range(r):
                total += root[k, i] * root[k, j]
            square[i, j] = total
            square[j, i] = total


@nb.njit(cache=True)
def solve_positive(matrix: np.ndarray, right: np.ndarray, answer: np.ndarray) -> bool:
    """Fill ``answer`` with matrix^-1 right by LDL', overwriting ``matrix``; return whether it is positive definite."""
    n = len(right)
    for j in range(n):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k] * matrix[k, k]
        if not pivot > 0.0:
            return False
        matrix[j, j] = pivot
        for i in range(j + 1, n):
            entry = matrix[i, j]
            for k in range(j):
                entry -= matrix[i, k] * matrix[j, k] * matrix[k, k]
            matrix[i, j] = entry / pivot
    for i in range(n):
        total = right[i]
        for k in range(i):
            total -= matrix[i, k] * answer[k]
        answer[i] = total
    for i in range(n):
        answer[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            answer[i] -= matrix[k, i] * answer[k]
    return True


@nb.njit(cache=True)
def solve_general(matrix: np.ndarray, right: np.ndarray, answer: np.ndarray) -> bool:
    """Fill ``answer`` by elimination with row pivots, overwriting ``matrix``; return whether it descends.

    It descends if ``answer.right > 0``, as it does for every matrix with positive symmetric part.
    """
    n = len(right)
    for i in range(n):
        answer[i] = right[i]
    for j in range(n):
        best = j
        for i in range(j + 1, n):
            if abs(matrix[i, j]) > abs(matrix[best, j]):
                best = i
        if matrix[best, j] == 0.0:
            return False
        if best != j:
            for k in range(n):
                matrix[j, k], matrix[best, k] = matrix[best, k], matrix[j, k]
            answer[j], answer[best] = answer[best], answer[j]
        for i in range(j + 1, n):
            share = matrix[i, j] / matrix[j, j]
            for k in range(j, n):
                matrix[i, k] -= share * matrix[j, k]
            answer[i] -= share * answer[j]
    along = 0.0
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            answer[i] -= matrix[i, k] * answer[k]
        answer[i] /= matrix[i, i]
    for i in range(n):
        along += answer[i] * right[i]
    return along > 0.0


@nb.njit(cache=True)
def newton_direction(
    hessian: np.ndarray,
    quadratic: np.ndarray,
    gradient: np.ndarray,
    symmetric: bool,
    scratch: np.ndarray,
    direction: np.ndarray,
) -> None:
    """Fill ``direction`` with hessian^-1 gradient; as much of ``quadratic`` is added as a descent needs."""
    shift = 0.0
    n = len(gradient)
    for _ in range(20):
        for i in range(n):
            for j in range(n):
                scratch[i, j] = hessian[i, j] + shift * quadratic[i, j]
        if symmetric:
            if solve_positive(scratch, gradient, direction):
                return
        elif solve_general(scratch, gradient, direction):
            return
        shift = 0.01 if shift == 0.0 else 4.0 * shift


@nb.njit(cache=True)
def tip_pose(
    y: np.ndarray, tables: Any, values: np.ndarray, point: np.ndarray, position: np.ndarray, quaternion: np.ndarray
) -> None:
    """Fill the tip's position (3,) m and quaternion (4,) w x y z at ``y``."""
    n, r = len(y) - 3, len(y)
    beyond = max(to_ball(y, point) - 1.0, 0.0)
    few = values[: tables.rotation.shape[1]]
    fill_monomials(point, tables.parent, tables.variable, few)
    square = 0.0
    for k in range(3):
        position[k] = tables.rest_tip[k]
        for j in range(r):
            position[k] += tables.frame[n + k, j] * y[j]
        angle = 0.0
        for m in range(len(few)):
            angle += tables.rotation[k, m] * few[m] * (1.0 + beyond * tables.degrees[m])
        quaternion[1 + k] = angle
        square += angle * angle
    half = 0.5 * math.sqrt(square)
    factor = 0.5 if half < 1e-9 else math.sin(half) / (2.0 * half)
    quaternion[0] = math.cos(half)
    for k in range(3):
        quaternion[1 + k] *= factor


@nb.njit(cache=True)
def fill_ports(
    y: np.ndarray,
    rest: np.ndarray,
    gradient: np.ndarray,
    hessian: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tables: Any,
    ports: Any,
    strains: np.ndarray,
    tips: np.ndarray,
) -> None:
    """Fill the inputs of both ports from the bare body's trial state; trial strains and tip go to row 1."""
    body, load = ports
    n, r = len(pressure), len(y)
    slopes = np.empty((r, r))
    _hessian_of_coordinate(hessian, tables.inverse, slopes)
    for i in range(n):
        strain = elastic = 0.0
        for j in range(r):
            strain += tables.frame[i, j] * (y[j] - rest[j])
            elastic += tables.inverse[j, i] * gradient[j]
        strains[1, i] = strain / tables.rest_volume[i]
        body[STRAIN, i], body[RATE, i] = strains[1, i], (strains[1, i] - strains[0, i]) / dt
        body[ELASTIC, i], body[ELASTIC_SLOPE, i] = elastic, _slope(slopes, n, i) * tables.rest_volume[i]
        body[PRESSURE, i], body[REST, i] = pressure[i], tables.rest_slope[i]
        body[ADDED, i] = body[ADDED_SLOPE, i] = 0.0
    for k in range(3):
        tips[1, k] = tables.rest_tip[k]
        for j in range(r):
            tips[1, k] += tables.frame[n + k, j] * y[j]
        load[TIP, k], load[TIP_VELOCITY, k] = tips[1, k], (tips[1, k] - tips[0, k]) / dt
        load[GRAVITY, k] = tables.gravity[k]
        for row in range(FORCE, LOAD_PORT_ROWS):
            load[row, k] = 0.0


@nb.njit(cache=True)
def _hessian_of_coordinate(hessian: np.ndarray, inverse: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` with the Hessian by z of what has ``hessian`` by y."""
    r = len(hessian)
    half = np.zeros((r, r))
    for i in range(r):
        for j in range(r):
            for k in range(r):
                half[i, j] += hessian[i, k] * inverse[k, j]
    for i in range(r):
        for j in range(r):
            out[i, j] = 0.0
            for k in range(r):
                out[i, j] += inverse[k, i] * half[k, j]


@nb.njit(cache=True)
def _slope(hessian: np.ndarray, n: int, chamber: int) -> float:
    """Return d pressure / d volume of one chamber, other volumes held and tip free, from the Hessian by z."""
    block, side, answer = np.empty((3, 3)), np.empty(3), np.empty(3)
    for i in range(3):
        side[i] = hessian[n + i, chamber]
        for j in range(3):
            block[i, j] = hessian[n + i, n + j]
    if not solve_positive(block, side, answer):
        return hessian[chamber, chamber]
    slope = hessian[chamber, chamber]
    for i in range(3):
        slope -= side[i] * answer[i]
    return slope


@nb.njit(cache=True)
def run_hooks(kernels: Any, parameters: Any, states: Any, port: np.ndarray, dt: float, commit: bool) -> None:
    """Let every effect add its reaction to ``port``."""
    for k in range(len(kernels)):
        kernels[k](parameters[k], states[k], port, dt, commit)


@nb.njit(cache=True)
def add_effects(
    y: np.ndarray,
    rest: np.ndarray,
    gradient: np.ndarray,
    hessian: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tables: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    tips: np.ndarray,
    values: np.ndarray,
    jacobian: np.ndarray,
    commit: bool,
) -> None:
    """Add the effects' reaction to ``gradient`` (r,) and its derivative to ``jacobian`` (r, r).

    ``gradient`` and ``hessian`` are the bare body's on entry. An effect may answer to the elastic pressure, which
    depends on all coordinates: that share is found by a second call with the elastic pressure raised.
    """
    body_kernels, body_parameters, body_states, load_kernels, load_parameters, load_states = hooks
    body, load = ports
    n, r = len(pressure), len(y)
    fill_ports(y, rest, gradient, hessian, dt, pressure, tables, ports, strains, tips)
    if len(body_kernels) > 0:
        run_hooks(body_kernels, body_parameters, body_states, body, dt, commit)
        if not commit:
            added, slope = body[ADDED].copy(), body[ADDED_SLOPE].copy()
            for i in range(n):
                body[ELASTIC, i] += PROBE * tables.rest_slope[i]
                body[ADDED, i] = body[ADDED_SLOPE, i] = 0.0
            run_hooks(body_kernels, body_parameters, body_states, body, dt, False)
            for i in range(n):
                share = (body[ADDED, i] - added[i]) / (PROBE * tables.rest_slope[i])
                direct = (slope[i] - share * body[ELASTIC_SLOPE, i]) / tables.rest_volume[i]
                for j in range(r):
                    gradient[j] += tables.frame[i, j] * added[i]
                for k in range(r):
                    elastic = 0.0
                    for j in range(r):
                        elastic += tables.inverse[j, i] * hessian[j, k]
                    for j in range(r):
                        jacobian[j, k] += tables.frame[i, j] * (share * elastic + direct * tables.frame[i, k])
    if len(load_kernels) > 0:
        run_hooks(load_kernels, load_parameters, load_states, load, dt, commit)
        for a in range(3):
            tilt = load[GRAVITY, a] - tables.gravity[a]
            for j in range(r):
                gradient[j] -= tables.frame[n + a, j] * load[FORCE, a]
                if tilt != 0.0:
                    gradient[j] -= tilt * polynomial(tables.weight[a, j], values)
                for k in range(r):
                    for b in range(3):
                        jacobian[j, k] -= tables.frame[n + a, j] * load[FORCE_SLOPE + a, b] * tables.frame[n + b, k]


@nb.njit(cache=True)
def run_kernel(
    y: np.ndarray,
    velocity: np.ndarray,
    rest: np.ndarray,
    dt: float,
    load: np.ndarray,
    tables: Any,
    hooks: Any,
    path: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
) -> tuple[int, float]:
    """Advance ``y`` and ``velocity`` (r,) in place by implicit Euler over every row of ``load`` (steps, r) Pa and N.

    Mass and damping are those at the start of a step. After it the velocity is scaled so that the kinetic energy is
    unchanged by the change of mass: energy is created nowhere.

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
    mass, stiff, root = np.zeros((r, r)), np.zeros((r, r)), np.empty((r, r))
    inertia, right, start = np.empty((r, r)), np.empty(r), np.empty(r)
    gradient, hessian, jacobian, scratch = np.empty(r), np.empty((r, r)), np.empty((r, r)), np.empty((r, r))
    direction, trial, pressure = np.empty(r), np.empty(r), np.empty(n)
    ports = (np.zeros((BODY_PORT_ROWS, n)), np.zeros((LOAD_PORT_ROWS, 3)))
    strains, tips = np.zeros((2, n)), np.zeros((2, 3))
    with_effects = len(hooks[0]) + len(hooks[3]) > 0
    mass_scale, mass_damping, stiffness_damping = tables.scales[0], tables.scales[1], tables.scales[2]
    roots = values[: max(tables.mass_root.shape[1], tables.stiffness_root.shape[1])]
    failed, farthest = 0, to_ball(y, point)
    fill_monomials(point, tables.parent, tables.variable, roots)
    fill_square(tables.mass_root, roots, root, mass)
    if with_effects:
        fill_potential(y, tables, values, point, gradient, hessian)
        fill_ports(y, rest, gradient, hessian, dt, load[0, :n], tables, ports, strains, tips)
        strains[0], tips[0] = strains[1], tips[1]
        fill_monomials(point, tables.parent, tables.variable, roots)
    for step in range(len(load)):
        if stiffness_damping > 0.0:
            fill_square(tables.stiffness_root, roots, root, stiff)
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
                add_effects(
                    y,
                    rest,
                    gradient,
                    hessian,
                    dt,
                    pressure,
                    tables,
                    hooks,
                    ports,
                    strains,
                    tips,
                    values,
                    jacobian,
                    False,
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
        if with_effects:
            fill_potential(y, tables, values, point, gradient, hessian)
            add_effects(
                y, rest, gradient, hessian, dt, pressure, tables, hooks, ports, strains, tips, values, jacobian, True
            )
            strains[0], tips[0] = strains[1], tips[1]
        kinetic = now = 0.0
        for i in range(r):
            velocity[i] = (y[i] - start[i]) / dt
        for i in range(r):
            for j in range(r):
                kinetic += velocity[i] * mass[i, j] * velocity[j]
        farthest = max(farthest, to_ball(y, point))
        fill_monomials(point, tables.parent, tables.variable, roots)
        fill_square(tables.mass_root, roots, root, mass)
        for i in range(r):
            for j in range(r):
                now += velocity[i] * mass[i, j] * velocity[j]
        if now > 0.0:
            factor = math.sqrt(kinetic / now)
            for i in range(r):
                velocity[i] *= factor
        if len(path) > 0:
            path[step] = y
        if len(position) > 0:
            tip_pose(y, tables, values, point, position[step], quaternion[step])
            fill_monomials(point, tables.parent, tables.variable, roots)
    return failed, farthest
