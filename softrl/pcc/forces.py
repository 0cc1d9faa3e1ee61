"""The balance of forces on the lumped body, with the effects that act on it, in J."""

from typing import Any

import numpy as np

from softrl.core.compiled import summing
from softrl.effects.call import run_ports
from softrl.effects.effect import (
    ADDED,
    ADDED_SLOPE,
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
    UNEVEN,
)
from softrl.pcc.pose import fill_loads, squared_bend, stumpff, tip_motion

# rows of the work array that one step fills
LAST, VELOCITY, TRIAL, RESIDUAL, STEP, OTHER, NEXT, MOVED, SEEN, GAINED = range(10)
WORK_ROWS = 10


@summing
def fill_shape(model: Any, y: np.ndarray, shape: np.ndarray) -> None:
    """Fill the ``shape`` (5,) at the coordinates ``y``: the same five, or bend and change of curvature in one plane."""
    plane = model[0]
    if len(model[11]) == 5:
        for i in range(5):
            shape[i] = y[i]
        return
    for i in range(2):
        shape[i], shape[3 + i] = plane[i] * y[0], plane[i] * y[1]
    shape[2] = 0.0


@summing
def stretching(model: Any) -> int:
    """Return how many of the coordinates, the first, stretch chambers."""
    return len(model[11]) - len(model[11]) // 2


@summing
def run_load_effects(hook: Any, ports: Any, model: Any, c: Any, dt: float, commit: bool) -> None:
    """Fill the load port at the shape and its rate in ``ports`` and run the effects; ``c`` are Stumpff's functions there."""
    port, length, gravity = ports[1], model[9][0], model[10]
    tip_motion(ports[2], length, c, ports[3], port[TIP], port[TIP_VELOCITY])
    for k in range(3):
        port[GRAVITY, k] = gravity[k]
        for row in range(FORCE, LOAD_PORT_ROWS):
            port[row, k] = 0.0
    run_ports(hook, port, dt, commit)


@summing
def run_body_effects(
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
    per_s, moving = 1.0 / dt, stretching(model)
    for c in range(len(pressure)):
        strain = elastic = 0.0
        for j in range(moving):
            moved = y[j] - rest[j]
            strain += to_strain[c, j] * moved
            elastic += to_elastic[c, j] * moved
        stiff = slope[c]
        port[STRAIN, c], port[RATE, c] = strain, (strain - strains[c]) * per_s
        port[ELASTIC, c], port[ELASTIC_SLOPE, c] = elastic, stiff
        port[PRESSURE, c], port[REST, c] = pressure[c], stiff
        port[ADDED, c], port[ADDED_SLOPE, c], port[UNEVEN, c] = 0.0, 0.0, 0.0
    run_ports(hook, port, dt, commit)


@summing
def fill_residual(
    y: np.ndarray,
    out: np.ndarray,
    work: np.ndarray,
    dt: float,
    per_s: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
) -> None:
    """Fill ``out`` (m,) with inertia + damping + elasticity + effects - pressure - loads at ``y``, in J.

    The coordinates change from ``work[LAST]`` and their rates from ``work[VELOCITY]`` at ``per_s``, and load effects with them;
    the body's effects act over ``dt`` from the beginning of the step. ``ports`` are the effects' two, and room for the shape, its
    rate and the loads on it (5,).
    """
    plane, stiffness, damping, mass, push, _, _, _, _, scalars, gravity, order = model
    body_hook, load_hook = hooks
    shape, loads = ports[2], ports[4]
    m, length, weight = len(order), scalars[0], scalars[1]
    fill_shape(model, y, shape)
    c = stumpff(squared_bend(shape))
    g0, g1, g2 = gravity[0], gravity[1], gravity[2]
    f0, f1, f2 = tip_force[0], tip_force[1], tip_force[2]
    if len(load_hook[0]) > 0:
        port = ports[1]
        for i in range(m):
            out[i] = (y[i] - work[LAST, i]) * per_s
        fill_shape(model, out, ports[3])
        run_load_effects(load_hook, ports, model, c, 1.0 / per_s, False)
        g0, g1, g2 = port[GRAVITY, 0], port[GRAVITY, 1], port[GRAVITY, 2]
        f0, f1, f2 = f0 + port[FORCE, 0], f1 + port[FORCE, 1], f2 + port[FORCE, 2]
    fill_loads(shape, length, c, weight * g0, weight * g1, weight * g2, f0, f1, f2, loads)
    loads[2] -= scalars[2]
    if m == 2:
        for i in range(2):
            loads[i] = plane[0] * loads[3 * i] + plane[1] * loads[3 * i + 1]
    for i in range(m):
        rate = (y[i] - work[LAST, i]) * per_s
        out[i] = stiffness[i] * y[i] + damping[i] * rate - loads[i]
        work[SEEN, i] = (rate - work[VELOCITY, i]) * per_s
        out[i] += mass[i] * work[SEEN, i]
    apart = stretching(model)
    for i in range(m - apart):
        out[i] += scalars[3] * work[SEEN, apart + i]
        out[apart + i] += scalars[3] * work[SEEN, i]
    if len(body_hook[0]) > 0:
        run_body_effects(body_hook, ports[0], y, model, pressure, strains, dt, False)
        added, share, to_elastic, rest = ports[0][ADDED], ports[0][UNEVEN], model[6], model[8]
        for k in range(len(pressure)):
            for i in range(apart):
                out[i] += push[i, k] * (added[k] - pressure[k])
            if share[k] == 0.0:
                continue
            uneven = 0.0
            for j in range(m - apart):
                uneven += share[k] / 3.0 * to_elastic[k, j] * (y[apart + j] - rest[apart + j])
            for i in range(m - apart):
                out[apart + i] += push[i, k] * uneven
        return
    for i in range(apart):
        for k in range(len(pressure)):
            out[i] -= push[i, k] * pressure[k]
