"""Constant-curvature body, compiled: two implicit stages a step, effects inside each.

Coordinates of the body are ``(b_x, b_y, epsilon)``: bend angle towards +x and +y in rad, and elongation of
the backbone relative to its length at rest. The robot moves in the columns of a basis of them (one column for
a single chamber).
"""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.core.compiled import borrowing
from softrl.effects.effect import ADDED_SLOPE, BODY_PORT_ROWS, LOAD_PORT_ROWS, STRAIN
from softrl.pcc.forces import (
    LAST,
    MOVED,
    NEXT,
    OTHER,
    RESIDUAL,
    SEEN,
    STEP,
    TRIAL,
    VELOCITY,
    fill_residual,
    run_body_effects,
    run_load_effects,
)
from softrl.pcc.pose import tip_pose

STAGE = 1.0 - math.sqrt(0.5)  # share of a step that each of its two stages takes
TOLERANCE = 1e-10  # rad or strain: a tenth of a nanometre at the tip of most robots
ACCEPTED = 1e-7  # at a kink of friction or contact: 20 nm at the tip of a robot of 0.2 m
MAX_ITERATIONS = 60
QUICK = 8  # steps with a Jacobian that is corrected on the way, before a careful search begins
NUDGE = 1e-7  # of a coordinate, for the Jacobian by differences
SAME = 0.01  # of the body's own slope: a smaller change of an effect's is left to the corrections
SLOW = 0.2  # a Newton step that shrinks less than to this share asks for a new Jacobian
SHORTEST = 1e-4  # share of a Newton step below which it is taken as it is


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
    per_s: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    tips: np.ndarray,
    slopes: np.ndarray,
) -> bool:
    """Try to solve one step with a kept ``inverse`` Jacobian that is corrected on the way; return whether it converged.

    What the effects' slopes change is known at once, what else changes is learned by Broyden's corrections. The search stops
    once the steps shrink fast enough for the sum of all further ones to stay below the tolerance.
    ``work[RESIDUAL]`` belongs to ``work[TRIAL]`` before and, without success, after it.
    """
    trial, residual, step, following = work[TRIAL], work[RESIDUAL], work[STEP], work[NEXT]
    m = len(trial)
    _follow(inverse, slopes, ports[0], model, work)
    size = _newton_step(inverse, residual, step)
    for _ in range(QUICK):
        for i in range(m):
            trial[i] += step[i]
        if size < 0.01 * TOLERANCE:
            return True
        fill_residual(trial, residual, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains, tips)
        known = _follow(inverse, slopes, ports[0], model, work)
        after = _newton_step(inverse, residual, following)
        if not after < 0.5 * size and after >= TOLERANCE:
            return False
        if after < TOLERANCE or after * after < TOLERANCE * (size - after):
            for i in range(m):
                trial[i] += following[i]
            return True
        if known:
            _correct(inverse, step, following)
        size = _newton_step(inverse, residual, step)
    return False


@borrowing
def _follow(inverse: np.ndarray, slopes: np.ndarray, port: np.ndarray, model: Any, work: np.ndarray) -> bool:
    """Bring the ``inverse`` Jacobian from the effects' ``slopes`` (chambers,) to those in ``port``; return if it had them.

    Sherman and Morrison's formula, chamber by chamber.
    """
    push, to_strain, rest, moved, seen = model[4], model[5], model[7], work[MOVED], work[SEEN]
    m, known = len(inverse), True
    for c in range(len(slopes)):
        change = port[ADDED_SLOPE, c] - slopes[c]
        if abs(change) < SAME * rest[c]:
            continue
        known, slopes[c], along = False, port[ADDED_SLOPE, c], 0.0
        for i in range(m):
            moved[i], seen[i] = 0.0, 0.0
            for j in range(m):
                moved[i] += inverse[i, j] * push[j, c]
                seen[i] += to_strain[c, j] * inverse[j, i]
            along += to_strain[c, i] * moved[i]
        share = change / (1.0 + change * along)
        for i in range(m):
            for j in range(m):
                inverse[i, j] -= share * moved[i] * seen[j]
    return known


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
    per_s: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    tips: np.ndarray,
    slopes: np.ndarray,
) -> bool:
    """Solve one implicit step for ``work[TRIAL]``; return whether it converged.

    Where corrections of the kept Jacobian do not do, Newton with one by differences: a fresh one that overshoots
    (friction and contact have kinks) is followed over a shorter way, until the next step is smaller.
    """
    trial, residual, step, other = work[TRIAL], work[RESIDUAL], work[STEP], work[OTHER]
    m = len(trial)
    fill_residual(trial, residual, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains, tips)
    if inverse[0, 0] != 0.0 and _quick(
        work, inverse, dt, per_s, pressure, tip_force, model, hooks, ports, strains, tips, slopes
    ):
        return True
    stale, size = True, np.inf
    for _ in range(MAX_ITERATIONS):
        fresh = stale
        if stale:
            for j in range(m):
                kept = trial[j]
                trial[j] = kept + NUDGE
                fill_residual(trial, other, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains, tips)
                trial[j] = kept
                for i in range(m):
                    jacobian[i, j] = (other[i] - residual[i]) / NUDGE
            _invert(jacobian, inverse)
            for c in range(len(slopes)):
                slopes[c] = ports[0][ADDED_SLOPE, c]
            stale = False
        size = _newton_step(inverse, residual, step)
        for i in range(m):
            trial[i] += step[i]
        if size < TOLERANCE:
            return True
        share = 1.0
        while True:
            fill_residual(trial, other, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains, tips)
            after = _newton_step(inverse, other, work[NEXT])
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
                trial[i] += work[NEXT, i]
            return True
        stale = share == 0.0 or after > SLOW * size
        if share > 0.0:
            for i in range(m):
                residual[i] = other[i]
        if 0.0 < share < SHORTEST and size < ACCEPTED:
            return True  # at the very kink, where no slope leads on
    return size < ACCEPTED


@borrowing
def _bend(basis: np.ndarray, y: np.ndarray, body: np.ndarray) -> None:
    """Fill bends and elongation ``body`` (3,) from the coordinates ``y`` (m,)."""
    for i in range(3):
        body[i] = 0.0
        for j in range(len(y)):
            body[i] += basis[i, j] * y[j]


@borrowing
def _lead_loads(hook: Any, port: np.ndarray, tips: np.ndarray, gravity: np.ndarray, stage_s: float, begun: np.ndarray) -> None:
    """Bring the load effects' states and the tip ``tips[0]`` from the begin of a step to where its second stage sets out.

    ``tips[1]`` is where the first stage ended, ``stage_s`` after the begin: both go on as they went until there. ``begun`` is
    room for the states.
    """
    states, further = hook[3], (1.0 - STAGE) / STAGE
    for i in range(len(states)):
        begun[i] = states[i]
    run_load_effects(hook, port, gravity, tips, stage_s, True)
    for i in range(len(states)):
        states[i] = begun[i] + further * (states[i] - begun[i])
    for k in range(3):
        tips[0, k] += further * (tips[1, k] - tips[0, k])


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

    A step is the singly diagonally implicit Runge-Kutta method of two stages and second order with ``STAGE`` on its diagonal
    (Alexander 1977): each stage is implicit Euler's of that share of the step, from where the first one has led. It forgets
    stiff modes at once (L-stable), as Euler's method does, and neither damps nor delays those that the step resolves.
    Load effects, whose states are rates of the tip and clocks, are led the same way (``_lead_loads``). The body's effects know
    how their states change over any time: they are asked at the end of both stages, and change them with the second.
    """
    basis, length = model[0], model[9][0]
    m, chambers = len(y), pressure.shape[1]
    work = np.zeros((9, m))
    jacobian, inverse = np.zeros((m, m)), np.zeros((m, m))
    ports = (np.zeros((BODY_PORT_ROWS, chambers)), np.zeros((LOAD_PORT_ROWS, 3)))
    strains, tips, slopes = np.zeros(chambers), np.zeros((2, 3)), np.zeros(chambers)
    body, scratch = np.zeros(3), np.zeros(4)
    to_strain, rest = model[5], model[8]
    _bend(basis, y, body)
    tip_pose(body, length, tips[0], scratch)
    for c in range(chambers):
        for j in range(m):
            strains[c] += to_strain[c, j] * (y[j] - rest[j])
    failed = 0
    body_hook, load_hook = hooks
    begun = np.empty(len(load_hook[3]))
    stage_s, rest_s = STAGE * dt, (1.0 - STAGE) * dt
    per_s = 1.0 / stage_s
    for k in range(len(pressure)):
        for i in range(m):
            work[LAST, i], work[VELOCITY, i] = y[i], velocity[i]
            work[TRIAL, i] = y[i] + stage_s * velocity[i]
        solved = solve_step(
            work, jacobian, inverse, stage_s, per_s, pressure[k], tip_force[k], model, hooks, ports, strains, tips, slopes
        )
        if len(load_hook[0]) > 0:
            _bend(basis, work[TRIAL], body)
            tip_pose(body, length, tips[1], scratch)
            _lead_loads(load_hook, ports[1], tips, model[10], stage_s, begun)
        for i in range(m):
            between = (work[TRIAL, i] - y[i]) * per_s
            work[LAST, i] = y[i] + rest_s * between
            work[VELOCITY, i] = velocity[i] + rest_s * (between - velocity[i]) * per_s
            work[TRIAL, i] += rest_s * between
        solved = (
            solve_step(work, jacobian, inverse, dt, per_s, pressure[k], tip_force[k], model, hooks, ports, strains, tips, slopes)
            and solved
        )
        if not solved:
            failed += 1
            inverse[0, 0] = 0.0
        for i in range(m):
            velocity[i] = (work[TRIAL, i] - work[LAST, i]) * per_s
            y[i] = work[TRIAL, i]
        _bend(basis, y, body)
        tip_pose(body, length, position[k], quaternion[k])
        if len(load_hook[0]) > 0:
            tips[1] = position[k]
            run_load_effects(load_hook, ports[1], model[10], tips, stage_s, True)
            tips[0] = tips[1]
        if len(body_hook[0]) > 0:
            run_body_effects(body_hook, ports[0], y, model, pressure[k], strains, dt, True)
            strains[:] = ports[0][STRAIN]
    return failed
