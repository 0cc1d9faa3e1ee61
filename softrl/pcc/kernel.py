"""Lumped body, compiled: two implicit stages a step, effects inside each.

Its shape is ``(b_x, b_y, epsilon, c_x, c_y)``: bend of the tip towards +x and +y in rad, elongation of the backbone relative to
its length at rest, and what the curvature loses from base to tip. These are the coordinates, too; those of a robot with a single
chamber are bend and change of curvature in its plane.
"""

from typing import Any

import numba as nb
import numpy as np

from softrl.core.compiled import summing
from softrl.effects.effect import STAGE
from softrl.effects.port import LOAD_PORT_ROWS, STRAIN, body_port
from softrl.pcc.forces import run_body_effects, run_load_effects
from softrl.pcc.model import FIRST, GAINED, LAST, MOVED, SECOND, TRIAL, VELOCITY, WORK_ROWS, fill_shape, stretching
from softrl.pcc.newton import solve_step
from softrl.pcc.pose import squared_bend, stumpff, tip_orientation, tip_position

REFRESHED = 16  # steps after which a Jacobian that was corrected on the way is made anew: inertia changes with the shape


@summing
def _keep(work: np.ndarray, stage: int, i: int, gained: float) -> None:
    """Keep the acceleration at the end of a stage, and how it changed in it; foretell the next step's change by the last two."""
    change = gained - work[GAINED, i]
    work[stage + 1, i] = 2.0 * change - work[stage, i]
    work[stage, i], work[GAINED, i] = change, gained


@summing
def _lead_loads(hook: Any, ports: Any, model: Any, stage_s: float, begun: np.ndarray) -> None:
    """Bring the load effects' states from the begin of a step to where its second stage sets out.

    The shape and its rate in ``ports`` are those where the first stage ended, ``stage_s`` after the begin: the states go on as
    they went until there. ``begun`` is room for them.
    """
    states, further = hook[3], (1.0 - STAGE) / STAGE
    for i in range(len(states)):
        begun[i] = states[i]
    run_load_effects(hook, ports, model, stumpff(squared_bend(ports[2])), stage_s, True)
    for i in range(len(states)):
        states[i] = begun[i] + further * (states[i] - begun[i])


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
    work, jacobian, inverse, ports, strains, slopes, begun = room
    body_hook, load_hook = hooks
    length, to_strain, rest = model.length, model.to_strain, model.rest
    m, chambers, shape, rate = len(model.order), len(strains), ports[2], ports[3]
    for c in range(chambers):
        for j in range(stretching(model)):
            strains[c] += to_strain[c, j] * (y[j] - rest[j])
    failed = 0
    stage_s, rest_s = STAGE * dt, (1.0 - STAGE) * dt
    per_s = 1.0 / stage_s
    for k in range(len(pressure)):
        if k % REFRESHED == 0:
            inverse[0, 0] = 0.0
        for i in range(m):
            work[LAST, i], work[VELOCITY, i] = y[i], velocity[i]
            work[TRIAL, i] = y[i] + stage_s * (velocity[i] + stage_s * (work[GAINED, i] + work[FIRST + 1, i]))
        solved = solve_step(
            work, jacobian, inverse, stage_s, per_s, pressure[k], tip_force[k], model, hooks, ports, strains, slopes
        )
        if len(load_hook[0]) > 0:
            for i in range(m):
                work[MOVED, i] = (work[TRIAL, i] - y[i]) * per_s
            fill_shape(model, work[TRIAL], shape)
            fill_shape(model, work[MOVED], rate)
            _lead_loads(load_hook, ports, model, stage_s, begun)
        for i in range(m):
            between = (work[TRIAL, i] - y[i]) * per_s
            gained = (between - velocity[i]) * per_s
            _keep(work, FIRST, i, gained)
            work[LAST, i] = y[i] + rest_s * between
            work[VELOCITY, i] = velocity[i] + rest_s * gained
            work[TRIAL, i] = work[LAST, i] + stage_s * (work[VELOCITY, i] + stage_s * (gained + work[SECOND + 1, i]))
        solved = (
            solve_step(work, jacobian, inverse, dt, per_s, pressure[k], tip_force[k], model, hooks, ports, strains, slopes)
            and solved
        )
        if not solved:
            failed += 1
            inverse[0, 0] = 0.0
        for i in range(m):
            velocity[i] = (work[TRIAL, i] - work[LAST, i]) * per_s
            _keep(work, SECOND, i, (velocity[i] - work[VELOCITY, i]) * per_s)
            y[i] = work[TRIAL, i]
        fill_shape(model, y, shape)
        tip_position(shape, length, position[k])
        tip_orientation(shape, quaternion[k])
        if len(load_hook[0]) > 0:
            fill_shape(model, velocity, rate)
            run_load_effects(load_hook, ports, model, stumpff(squared_bend(shape)), stage_s, True)
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
    stiff modes at once (L-stable), as Euler's method does, and neither damps nor delays those that the step resolves. The search
    for each begins where its acceleration leads if that changes from stage to stage as it did in the last two steps.
    Load effects, whose states are rates of the tip and clocks, are led the same way (``_lead_loads``). The body's effects know
    how their states change over any time: they are asked at the end of both stages, and change them with the second.
    """
    m, chambers = len(y), pressure.shape[1]
    room = (
        np.zeros((WORK_ROWS, m)),
        np.zeros((m, m)),
        np.zeros((m, m)),
        (body_port(chambers), np.zeros((LOAD_PORT_ROWS, 3)), np.zeros(5), np.zeros(5), np.zeros(5)),
        np.zeros(chambers),
        np.zeros((chambers, chambers)),
        np.zeros(len(hooks[1][3])),
    )
    return _advance(y, velocity, dt, pressure, tip_force, model, hooks, position, quaternion, room)
