"""Constant-curvature body, compiled: closed-form kinematics, implicit Euler, effects inside each step.

Coordinates of the body are ``(b_x, b_y, epsilon)``: bend angle towards +x and +y in rad, and elongation of
the backbone relative to its length at rest. The robot moves in the columns of a basis of them (one column for
a single chamber).
"""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.effects.call import borrowing, run_ports
from softrl.effects.effect import (
    ADDED,
    BODY_PORT_ROWS,
    ELASTIC,
    ELASTIC_SLOPE,
    FORCE,
    GRAVITY,
    LOAD_PORT_ROWS,
    PRESSURE,
    RATE,
    REST,
    STRAIN,
    TIP,
    TIP_VELOCITY,
)

TOLERANCE = 1e-10  # rad or strain: a tenth of a nanometre at the tip of most robots
ACCEPTED = 1e-7  # at a kink of friction or contact: 20 nm at the tip of a robot of 0.2 m
MAX_ITERATIONS = 60
QUICK = 8  # steps with a Jacobian that is corrected on the way, before a careful search begins
SERIES_BELOW = 4.0  # squared bend angle under which nine terms of the series are exact to the last digit
NUDGE = 1e-7  # of a coordinate, for the Jacobian by differences
SLOW = 0.2  # a Newton step that shrinks less than to this share asks for a new Jacobian
SHORTEST = 1e-4  # share of a Newton step below which it is taken as it is

# columns of the work array that one step fills
_LAST, _VELOCITY, _TRIAL, _RESIDUAL, _STEP, _OTHER, _NEXT = range(7)


@borrowing
def _remainders(x: float) -> tuple[float, float]:
    """Return ``(f - 1/2) / x`` and ``(F - 1/6) / x`` at ``x = b^2``, see ``shape_functions``."""
    if x < SERIES_BELOW:  # 1 / 4! ... 1 / 20! and 1 / 5! ... 1 / 21!, with alternating signs
        f = 1 / 6402373705728000 - x * (1 / 2432902008176640000)
        f = -1 / 479001600 + x * (1 / 87178291200 + x * (-1 / 20922789888000 + x * f))
        f = -1 / 24 + x * (1 / 720 + x * (-1 / 40320 + x * (1 / 3628800 + x * f)))
        h = 1 / 121645100408832000 - x * (1 / 51090942171709440000)
        h = -1 / 6227020800 + x * (1 / 1307674368000 + x * (-1 / 355687428096000 + x * h))
        h = -1 / 120 + x * (1 / 5040 + x * (-1 / 362880 + x * (1 / 39916800 + x * h)))
        return f, h
    b = math.sqrt(x)
    return ((1.0 - math.cos(b)) / x - 0.5) / x, ((b - math.sin(b)) / (b * x) - 1 / 6) / x


@borrowing
def shape_functions(x: float) -> tuple[float, float, float, float, float, float]:
    """Return f, g, F and their derivatives by the bend angle b, over b, at ``x = b^2``.

    ``f = (1 - cos b) / b^2``, ``g = sin b / b``, ``F = (b - sin b) / b^3``: all are entire functions of
    ``b^2``. With ``f = 1/2 + x u`` and ``F = 1/6 + x v`` the other four follow from u and v without a loss of digits.
    """
    u, v = _remainders(x)
    f, h = 0.5 + x * u, 1 / 6 + x * v
    return f, 1.0 - x * h, h, -2.0 * u - h, h - f, u - 3.0 * v


@borrowing
def tip_pose(body: np.ndarray, length: float, position: np.ndarray, quaternion: np.ndarray) -> None:
    """Fill the tip's position (3,) m and orientation (4,) w x y z of a body bent by ``body`` (3,)."""
    x = body[0] * body[0] + body[1] * body[1]
    u, v = _remainders(x)
    f, g = 0.5 + x * u, 1.0 - x * (1 / 6 + x * v)
    stretched = length * (1.0 + body[2])
    position[0], position[1], position[2] = stretched * f * body[0], stretched * f * body[1], stretched * g
    x *= 0.25
    u, v = _remainders(x)
    half = 0.5 - 0.5 * x * (1 / 6 + x * v)
    quaternion[0] = 1.0 - x * (0.5 + x * u)
    quaternion[1], quaternion[2], quaternion[3] = -half * body[1], half * body[0], 0.0


@borrowing
def _load_effects(hook: Any, port: np.ndarray, gravity: np.ndarray, tips: np.ndarray, dt: float, commit: bool) -> None:
    """Fill the load port at the tip ``tips[1]`` and run the effects on it."""
    for k in range(3):
        port[TIP, k] = tips[1, k]
        port[TIP_VELOCITY, k] = (tips[1, k] - tips[0, k]) / dt
        port[GRAVITY, k] = gravity[k]
        for row in range(FORCE, LOAD_PORT_ROWS):
            port[row, k] = 0.0
    run_ports(hook, port, dt, commit)


@borrowing
def _body_effects(
    hook: Any,
    port: np.ndarray,
    y: np.ndarray,
    model: Any,
    pressure: np.ndarray,
    strains: np.ndarray,
    dt: float,
    commit: bool,
) -> None:
    """Fill the body port at ``y`` and run the effects on it."""
    to_strain, to_elastic, slope, rest = model[5], model[6], model[7], model[8]
    for c in range(len(pressure)):
        strain = elastic = 0.0
        for j in range(len(y)):
            moved = y[j] - rest[j]
            strain += to_strain[c, j] * moved
            elastic += to_elastic[c, j] * moved
        strains[1, c] = strain
        port[STRAIN, c], port[RATE, c] = strain, (strain - strains[0, c]) / dt
        port[ELASTIC, c], port[ELASTIC_SLOPE, c] = elastic, slope[c]
        port[PRESSURE, c], port[REST, c] = pressure[c], slope[c]
        for row in range(ADDED, BODY_PORT_ROWS):
            port[row, c] = 0.0
    run_ports(hook, port, dt, commit)


@borrowing
def _residual(
    y: np.ndarray,
    out: np.ndarray,
    work: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    tips: np.ndarray,
) -> None:
    """Fill ``out`` (m,) with inertia + damping + elasticity + effects - pressure - loads at ``y``, in J."""
    basis, stiffness, damping, mass, push, _, _, _, _, scalars, gravity = model
    body_hook, load_hook = hooks
    bx = by = eps = 0.0
    m = len(y)
    for j in range(m):
        bx += basis[0, j] * y[j]
        by += basis[1, j] * y[j]
        eps += basis[2, j] * y[j]
    f, g, h, df, dg, dh = shape_functions(bx * bx + by * by)
    length = scalars[0]
    stretched = length * (1.0 + eps)
    g0, g1, g2 = gravity[0], gravity[1], gravity[2]
    f0, f1, f2 = tip_force[0], tip_force[1], tip_force[2]
    if len(load_hook[0]) > 0:
        port = ports[1]
        tips[1, 0], tips[1, 1], tips[1, 2] = stretched * f * bx, stretched * f * by, stretched * g
        _load_effects(load_hook, port, gravity, tips, dt, False)
        g0, g1, g2 = port[GRAVITY, 0], port[GRAVITY, 1], port[GRAVITY, 2]
        f0, f1, f2 = f0 + port[FORCE, 0], f1 + port[FORCE, 1], f2 + port[FORCE, 2]
    weight = scalars[1]
    # generalised loads: weight at the centre of mass (L F b, L f), force at the tip (L f b, L g)
    across, along = weight * (g0 * bx + g1 * by), weight * g2
    across_tip, along_tip = f0 * bx + f1 * by, f2
    common = stretched * (dh * across + df * along + df * across_tip + dg * along_tip)
    q0 = common * bx + stretched * (h * weight * g0 + f * f0)
    q1 = common * by + stretched * (h * weight * g1 + f * f1)
    q2 = length * (h * across + f * along + f * across_tip + g * along_tip) - scalars[2]
    per_s = 1.0 / dt
    for i in range(m):
        rate = (y[i] - work[_LAST, i]) * per_s
        out[i] = (
            stiffness[i] * y[i]
            + damping[i] * rate
            + mass[i] * (rate - work[_VELOCITY, i]) * per_s
            - basis[0, i] * q0
            - basis[1, i] * q1
            - basis[2, i] * q2
        )
    if len(body_hook[0]) == 0:
        for i in range(m):
            for c in range(len(pressure)):
                out[i] -= push[i, c] * pressure[c]
        return
    _body_effects(body_hook, ports[0], y, model, pressure, strains, dt, False)
    for i in range(m):
        for c in range(len(pressure)):
            out[i] += push[i, c] * (ports[0][ADDED, c] - pressure[c])


@borrowing
def _invert(matrix: np.ndarray, inverse: np.ndarray) -> None:
    """Fill the inverse of a matrix of order 1 or 3."""
    if len(matrix) == 1:
        inverse[0, 0] = 1.0 / matrix[0, 0]
        return
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            inverse[j, i] = matrix[a, c] * matrix[b, d] - matrix[a, d] * matrix[b, c]
    determinant = matrix[0, 0] * inverse[0, 0] + matrix[0, 1] * inverse[1, 0] + matrix[0, 2] * inverse[2, 0]
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= determinant


@borrowing
def _newton_step(inverse: np.ndarray, residual: np.ndarray, step: np.ndarray) -> float:
    """Fill ``step = -inverse residual`` and return its largest entry."""
    size = 0.0
    for i in range(len(step)):
        step[i] = 0.0
        for j in range(len(step)):
            step[i] -= inverse[i, j] * residual[j]
        size = max(size, abs(step[i]))
    return size


@borrowing
def _quick(
    work: np.ndarray,
    inverse: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    tips: np.ndarray,
) -> bool:
    """Try to solve one step with Broyden's corrections of the ``inverse`` Jacobian; return whether it converged.

    The search stops once the steps shrink fast enough for the sum of all further ones to stay below the tolerance.
    ``work[_RESIDUAL]`` belongs to ``work[_TRIAL]`` before and, without success, after it.
    """
    trial, residual, step, following = work[_TRIAL], work[_RESIDUAL], work[_STEP], work[_NEXT]
    m = len(trial)
    size = _newton_step(inverse, residual, step)
    for _ in range(QUICK):
        for i in range(m):
            trial[i] += step[i]
        if size < 0.01 * TOLERANCE:
            return True
        _residual(trial, residual, work, dt, pressure, tip_force, model, hooks, ports, strains, tips)
        after = _newton_step(inverse, residual, following)
        if not after < 0.5 * size and after >= TOLERANCE:
            return False
        if after < TOLERANCE or after * after < TOLERANCE * (size - after):
            for i in range(m):
                trial[i] += following[i]
            return True
        _correct(inverse, step, following)
        size = _newton_step(inverse, residual, step)
    return False


@borrowing
def _correct(inverse: np.ndarray, step: np.ndarray, following: np.ndarray) -> None:
    """Correct the ``inverse`` Jacobian such that it maps the change of the residual over ``step`` to ``step``.

    Broyden's first update in the form of Sherman and Morrison; ``following`` is what the old inverse proposes next.
    """
    m = len(step)
    scale = 0.0
    for i in range(m):
        scale += step[i] * (step[i] - following[i])
    if scale <= 0.0:
        return
    for j in range(m):
        along = 0.0
        for i in range(m):
            along += step[i] * inverse[i, j]
        for i in range(m):
            inverse[i, j] += following[i] * along / scale


@borrowing
def solve_step(
    work: np.ndarray,
    jacobian: np.ndarray,
    inverse: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    tips: np.ndarray,
) -> bool:
    """Solve one implicit step for ``work[_TRIAL]``; return whether it converged.

    Where corrections of the kept Jacobian do not do, Newton with one by differences: a fresh one that overshoots
    (friction and contact have kinks) is followed over a shorter way, until the next step is smaller.
    """
    trial, residual, step, other = work[_TRIAL], work[_RESIDUAL], work[_STEP], work[_OTHER]
    m = len(trial)
    _residual(trial, residual, work, dt, pressure, tip_force, model, hooks, ports, strains, tips)
    if inverse[0, 0] != 0.0 and _quick(work, inverse, dt, pressure, tip_force, model, hooks, ports, strains, tips):
        return True
    stale, size = True, np.inf
    for _ in range(MAX_ITERATIONS):
        fresh = stale
        if stale:
            for j in range(m):
                kept = trial[j]
                trial[j] = kept + NUDGE
                _residual(trial, other, work, dt, pressure, tip_force, model, hooks, ports, strains, tips)
                trial[j] = kept
                for i in range(m):
                    jacobian[i, j] = (other[i] - residual[i]) / NUDGE
            _invert(jacobian, inverse)
            stale = False
        size = _newton_step(inverse, residual, step)
        for i in range(m):
            trial[i] += step[i]
        if size < TOLERANCE:
            return True
        share = 1.0
        while True:
            _residual(trial, other, work, dt, pressure, tip_force, model, hooks, ports, strains, tips)
            after = _newton_step(inverse, other, work[_NEXT])
            if after < (1.0 - 0.25 * share) * size or after < TOLERANCE or share < SHORTEST:
                break
            shorter = 0.5 * share if fresh else 0.0
            for i in range(m):
                trial[i] += (shorter - share) * step[i]
            share = shorter
            if not fresh:
                break
        if after < TOLERANCE and share > 0.0:
            for i in range(m):
                trial[i] += work[_NEXT, i]
            return True
        stale = share == 0.0 or after > SLOW * size
        if share > 0.0:
            for i in range(m):
                residual[i] = other[i]
        if 0.0 < share < SHORTEST and size < ACCEPTED:
            return True  # at the very kink, where no slope leads on
    return size < ACCEPTED


@nb.njit(cache=True, nogil=True)
def run_kernel(
    y: np.ndarray,
    velocity: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    position: np.ndarray,
    quaternion: np.ndarray,
) -> int:
    """Advance ``y`` and ``velocity`` (m,) in place over all rows of ``pressure``; return the steps that failed.

    ``position`` (steps, 3) and ``quaternion`` (steps, 4) are filled.
    """
    basis, length = model[0], model[9][0]
    m, chambers = len(y), pressure.shape[1]
    work = np.zeros((7, m))
    jacobian, inverse = np.zeros((m, m)), np.zeros((m, m))
    ports = (np.zeros((BODY_PORT_ROWS, chambers)), np.zeros((LOAD_PORT_ROWS, 3)))
    strains, tips = np.zeros((2, chambers)), np.zeros((2, 3))
    body, scratch = np.zeros(3), np.zeros(4)
    to_strain, rest = model[5], model[8]
    for i in range(3):
        for j in range(m):
            body[i] += basis[i, j] * y[j]
    tip_pose(body, length, tips[0], scratch)
    for c in range(chambers):
        for j in range(m):
            strains[0, c] += to_strain[c, j] * (y[j] - rest[j])
    failed = 0
    body_hook, load_hook = hooks
    for k in range(len(pressure)):
        for i in range(m):
            work[_LAST, i], work[_VELOCITY, i] = y[i], velocity[i]
            work[_TRIAL, i] = y[i] + dt * velocity[i]
        if not solve_step(work, jacobian, inverse, dt, pressure[k], tip_force[k], model, hooks, ports, strains, tips):
            failed += 1
            inverse[0, 0] = 0.0
        for i in range(m):
            velocity[i] = (work[_TRIAL, i] - y[i]) / dt
            y[i] = work[_TRIAL, i]
        for i in range(3):
            body[i] = 0.0
            for j in range(m):
                body[i] += basis[i, j] * y[j]
        tip_pose(body, length, position[k], quaternion[k])
        if len(load_hook[0]) > 0:
            tips[1] = position[k]
            _load_effects(load_hook, ports[1], model[10], tips, dt, True)
            tips[0] = tips[1]
        if len(body_hook[0]) > 0:
            _body_effects(body_hook, ports[0], y, model, pressure[k], strains, dt, True)
            strains[0] = strains[1]
    return failed
