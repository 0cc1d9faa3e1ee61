"""Constant-curvature body, compiled: two implicit stages a step, effects inside each.

Coordinates of the body are ``(b_x, b_y, epsilon)``: bend angle towards +x and +y in rad, and elongation of
the backbone relative to its length at rest. The robot moves in the columns of a basis of them (one column for
a single chamber).
"""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.core.compiled import summing
from softrl.effects.effect import BODY_PORT_ROWS, LOAD_PORT_ROWS, STRAIN
from softrl.pcc.forces import LAST, TRIAL, VELOCITY, run_body_effects, run_load_effects
from softrl.pcc.newton import solve_step
from softrl.pcc.pose import tip_pose

STAGE = 1.0 - math.sqrt(0.5)  # share of a step that each of its two stages takes


@summing
def _bend(basis: np.ndarray, y: np.ndarray, body: np.ndarray) -> None:
    """Fill bends and elongation ``body`` (3,) from the coordinates ``y`` (m,)."""
    for i in range(3):
        body[i] = 0.0
        for j in range(len(y)):
            body[i] += basis[i, j] * y[j]


@summing
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


@summing
def _advance(
    y: np.ndarray,
    velocity: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    position: np.ndarray,
    quaternion: np.ndarray,
    room: Any,
) -> int:
    """Do what ``run_kernel`` does in its ``room`` of zeros; where arrays are made, every use of one counts its references."""
    work, jacobian, inverse, ports, strains, tips, slopes, body, scratch, begun = room
    body_hook, load_hook = hooks
    basis, length, to_strain, rest = model[0], model[9][0], model[5], model[8]
    m, chambers = len(y), len(strains)
    _bend(basis, y, body)
    tip_pose(body, length, tips[0], scratch)
    for c in range(chambers):
        for j in range(m):
            strains[c] += to_strain[c, j] * (y[j] - rest[j])
    failed = 0
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
            for i in range(3):
                tips[1, i] = position[k, i]
            run_load_effects(load_hook, ports[1], model[10], tips, stage_s, True)
            for i in range(3):
                tips[0, i] = tips[1, i]
        if len(body_hook[0]) > 0:
            run_body_effects(body_hook, ports[0], y, model, pressure[k], strains, dt, True)
            for c in range(chambers):
                strains[c] = ports[0][STRAIN, c]
    return failed


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
    m, chambers = len(y), pressure.shape[1]
    room = (
        np.zeros((9, m)),
        np.zeros((m, m)),
        np.zeros((m, m)),
        (np.zeros((BODY_PORT_ROWS, chambers)), np.zeros((LOAD_PORT_ROWS, 3))),
        np.zeros(chambers),
        np.zeros((2, 3)),
        np.zeros(chambers),
        np.zeros(3),
        np.zeros(4),
        np.zeros(len(hooks[1][3])),
    )
    return _advance(y, velocity, dt, pressure, tip_force, model, hooks, position, quaternion, room)
