"""Constant-curvature body, compiled: closed-form kinematics, implicit Euler, effects inside each step.

Coordinates of the body are ``(b_x, b_y, epsilon)``: bend angle towards +x and +y in rad, and elongation of
the backbone relative to its length at rest. The robot moves in the columns of a basis of them (one column for
a single chamber).
"""

import math
from typing import Any

import numba as nb
import numpy as np

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
SERIES_BELOW = 0.25  # squared bend angle under which the series beat the closed forms
NUDGE = 1e-7  # of a coordinate, for the Jacobian by differences
SLOW = 0.2  # a Newton step that shrinks less than to this share asks for a new Jacobian
SHORTEST = 1e-4  # share of a Newton step below which it is taken as it is

# columns of the work array that one step fills
_LAST, _VELOCITY, _TRIAL, _RESIDUAL, _STEP, _OTHER, _NEXT = range(7)


@nb.njit(cache=True)
def shape_functions(x: float) -> tuple[float, float, float, float, float, float]:
    """Return f, g, F and their derivatives by the bend angle b, over b, at ``x = b^2``.

    ``f = (1 - cos b) / b^2``, ``g = sin b / b``, ``F = (b - sin b) / b^3``: all are entire functions of
    ``b^2``, which the power series show; the closed forms lose digits near zero.
    """
    if x < SERIES_BELOW:
        f = 0.5 + x * (-1 / 24 + x * (1 / 720 + x * (-1 / 40320 + x * (1 / 3628800 - x / 479001600))))
        g = 1.0 + x * (-1 / 6 + x * (1 / 120 + x * (-1 / 5040 + x * (1 / 362880 - x / 39916800))))
        h = 1 / 6 + x * (-1 / 120 + x * (1 / 5040 + x * (-1 / 362880 + x * (1 / 39916800 - x / 6227020800))))
        df = 2.0 * (-1 / 24 + x * (2 / 720 + x * (-3 / 40320 + x * (4 / 3628800 - 5 * x / 479001600))))
        dg = 2.0 * (-1 / 6 + x * (2 / 120 + x * (-3 / 5040 + x * (4 / 362880 - 5 * x / 39916800))))
        dh = 2.0 * (-1 / 120 + x * (2 / 5040 + x * (-3 / 362880 + x * (4 / 39916800 - 5 * x / 6227020800))))
        return f, g, h, df, dg, dh
    b = math.sqrt(x)
    sine, cosine = math.sin(b), math.cos(b)
    f, g, h = (1.0 - cosine) / x, sine / b, (b - sine) / (b * x)
    return f, g, h, (g - 2.0 * f) / x, (cosine - g) / x, (f - 3.0 * h) / x


@nb.njit(cache=True)
def tip_pose(body: np.ndarray, length: float, position: np.ndarray, quaternion: np.ndarray) -> None:
    """Fill the tip's position (3,) m and orientation (4,) w x y z of a body bent by ``body`` (3,)."""
    x = body[0] * body[0] + body[1] * body[1]
    f, g, _, _, _, _ = shape_functions(x)
    stretched = length * (1.0 + body[2])
    position[0], position[1], position[2] = stretched * f * body[0], stretched * f * body[1], stretched * g
    _, half, _, _, _, _ = shape_functions(0.25 * x)
    quaternion[0] = math.cos(0.5 * math.sqrt(x))
    quaternion[1], quaternion[2], quaternion[3] = -0.5 * half * body[1], 0.5 * half * body[0], 0.0


@nb.njit(cache=True)
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
    commit: bool,
) -> None:
    """Fill ``out`` (m,) with inertia + damping + elasticity + effects - pressure - loads at ``y``, in J."""
    basis, stiffness, damping, mass, push, to_strain, to_elastic, slope, rest, scalars, gravity = model
    body_kernels, body_parameters, body_states, load_kernels, load_parameters, load_states = hooks
    body_port, load_port = ports
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
    if len(load_kernels) > 0:
        tips[1, 0], tips[1, 1], tips[1, 2] = stretched * f * bx, stretched * f * by, stretched * g
        for k in range(3):
            load_port[TIP, k] = tips[1, k]
            load_port[TIP_VELOCITY, k] = (tips[1, k] - tips[0, k]) / dt
            load_port[GRAVITY, k] = gravity[k]
            load_port[FORCE, k] = 0.0
            for row in range(FORCE + 1, LOAD_PORT_ROWS):
                load_port[row, k] = 0.0
        for k in range(len(load_kernels)):
            load_kernels[k](load_parameters[k], load_states[k], load_port, dt, commit)
        g0, g1, g2 = load_port[GRAVITY, 0], load_port[GRAVITY, 1], load_port[GRAVITY, 2]
        f0, f1, f2 = f0 + load_port[FORCE, 0], f1 + load_port[FORCE, 1], f2 + load_port[FORCE, 2]
    weight = scalars[1]
    # generalised loads: weight at the centre of mass (L F b, L f), force at the tip (L f b, L g)
    across, along = weight * (g0 * bx + g1 * by), weight * g2
    across_tip, along_tip = f0 * bx + f1 * by, f2
    common = stretched * (dh * across + df * along + df * across_tip + dg * along_tip)
    q0 = common * bx + stretched * (h * weight * g0 + f * f0)
    q1 = common * by + stretched * (h * weight * g1 + f * f1)
    q2 = length * (h * across + f * along + f * across_tip + g * along_tip) - scalars[2]
    for i in range(m):
        moved = y[i] - work[_LAST, i]
        out[i] = (
            stiffness[i] * y[i]
            + damping[i] * moved / dt
            + mass[i] * (moved / dt - work[_VELOCITY, i]) / dt
            - basis[0, i] * q0
            - basis[1, i] * q1
            - basis[2, i] * q2
        )
        for c in range(len(pressure)):
            out[i] -= push[i, c] * pressure[c]
    if len(body_kernels) == 0:
        return
    for c in range(len(pressure)):
        strain = elastic = 0.0
        for j in range(m):
            strain += to_strain[c, j] * (y[j] - rest[j])
            elastic += to_elastic[c, j] * (y[j] - rest[j])
        strains[1, c] = strain
        body_port[STRAIN, c], body_port[RATE, c] = strain, (strain - strains[0, c]) / dt
        body_port[ELASTIC, c], body_port[ELASTIC_SLOPE, c] = elastic, slope[c]
        body_port[PRESSURE, c], body_port[REST, c] = pressure[c], slope[c]
        for row in range(ADDED, BODY_PORT_ROWS):
            body_port[row, c] = 0.0
    for k in range(len(body_kernels)):
        body_kernels[k](body_parameters[k], body_states[k], body_port, dt, commit)
    for i in range(m):
        for c in range(len(pressure)):
            out[i] += push[i, c] * body_port[ADDED, c]


@nb.njit(cache=True)
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


@nb.njit(cache=True)
def _newton_step(inverse: np.ndarray, residual: np.ndarray, step: np.ndarray) -> float:
    """Fill ``step = -inverse residual`` and return its largest entry."""
    size = 0.0
    for i in range(len(step)):
        step[i] = 0.0
        for j in range(len(step)):
            step[i] -= inverse[i, j] * residual[j]
        size = max(size, abs(step[i]))
    return size


@nb.njit(cache=True)
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

    Newton with a Jacobian by differences that is kept from step to step and made anew when it converges
    slowly; a fresh one that overshoots (friction and contact have kinks) is followed over a shorter way,
    until the next step is smaller.
    """
    trial, residual, step, other = work[_TRIAL], work[_RESIDUAL], work[_STEP], work[_OTHER]
    m = len(trial)
    _residual(trial, residual, work, dt, pressure, tip_force, model, hooks, ports, strains, tips, False)
    stale, size = inverse[0, 0] == 0.0, np.inf
    for _ in range(MAX_ITERATIONS):
        fresh = stale
        if stale:
            for j in range(m):
                kept = trial[j]
                trial[j] = kept + NUDGE
                _residual(trial, other, work, dt, pressure, tip_force, model, hooks, ports, strains, tips, False)
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
            _residual(trial, other, work, dt, pressure, tip_force, model, hooks, ports, strains, tips, False)
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


@nb.njit(cache=True)
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
    with_effects = len(hooks[0]) + len(hooks[3]) > 0
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
        if with_effects:
            _residual(
                y,
                work[_RESIDUAL],
                work,
                dt,
                pressure[k],
                tip_force[k],
                model,
                hooks,
                ports,
                strains,
                tips,
                True,
            )
            strains[0] = strains[1]
            tips[0] = tips[1]
        for i in range(3):
            body[i] = 0.0
            for j in range(m):
                body[i] += basis[i, j] * y[j]
        tip_pose(body, length, position[k], quaternion[k])
    return failed
