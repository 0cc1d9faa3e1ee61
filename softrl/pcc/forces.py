"""The balance of forces on the lumped body, with the effects that act on it, in J."""

from typing import Any

import numpy as np

from softrl.core.compiled import summing
from softrl.effects.call import run_ports
from softrl.effects.port import (
    ADDED,
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
    clear,
    share_of_all,
)
from softrl.pcc.inertia import add_inertia
from softrl.pcc.model import LAST, MOVED, SEEN, VELOCITY, fill_shape, stretching
from softrl.pcc.pose import squared_bend, stumpff, tip_motion, work_of_loads


@summing
def run_load_effects(hook: Any, ports: Any, model: Any, c: Any, dt: float, commit: bool) -> None:
    """Fill the load port at the shape and its rate in ``ports`` and run the effects; ``c`` are Stumpff's functions there."""
    port = ports[1]
    tip_motion(ports[2], model.length, c, ports[3], port[TIP], port[TIP_VELOCITY])
    for k in range(3):
        port[GRAVITY, k] = model.gravity[k]
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
    to_strain, to_elastic, slope, rest = model.to_strain, model.to_elastic, model.slope, model.rest
    per_s = 1.0 / dt
    for c in range(len(pressure)):
        strain = elastic = 0.0
        for j in range(stretching(model)):
            moved = y[j] - rest[j]
            strain += to_strain[c, j] * moved
            elastic += to_elastic[c, j] * moved
        port[STRAIN, c], port[RATE, c] = strain, (strain - strains[c]) * per_s
        port[ELASTIC, c], port[ELASTIC_SLOPE, c] = elastic, slope[c]
        port[PRESSURE, c], port[REST, c] = pressure[c], model.wall[c]
    clear(port)
    run_ports(hook, port, dt, commit)


@summing
def _fill_loads(
    y: np.ndarray, rate: np.ndarray, per_s: float, tip_force: np.ndarray, model: Any, hook: Any, ports: Any
) -> None:
    """Fill ``ports[4]`` with the work of weight, tip force and load effects per change of each coordinate, J."""
    shape, loads, weight, end, gravity = ports[2], ports[4], model.mass, model.end, model.gravity
    fill_shape(model, y, shape)
    c = stumpff(squared_bend(shape))
    g0, g1, g2 = gravity[0], gravity[1], gravity[2]
    f0, f1, f2 = tip_force[0], tip_force[1], tip_force[2]
    if len(hook[0]) > 0:
        port = ports[1]
        fill_shape(model, rate, ports[3])
        run_load_effects(hook, ports, model, c, 1.0 / per_s, False)
        g0, g1, g2 = port[GRAVITY, 0], port[GRAVITY, 1], port[GRAVITY, 2]
        f0, f1, f2 = f0 + port[FORCE, 0], f1 + port[FORCE, 1], f2 + port[FORCE, 2]
    f0, f1, f2 = f0 + end * g0, f1 + end * g1, f2 + end * g2
    work_of_loads(shape, model.length, c, weight * g0, weight * g1, weight * g2, f0, f1, f2, loads)
    loads[2] -= model.axial_weight
    if len(model.order) == 2:
        for i in range(2):
            loads[i] = model.plane[0] * loads[3 * i] + model.plane[1] * loads[3 * i + 1]


@summing
def _add_walls(y: np.ndarray, out: np.ndarray, model: Any, port: np.ndarray) -> None:
    """Add to ``out`` (m,) what the body's effects have added to the resistance of the walls."""
    push, first = model.push, stretching(model)
    for k in range(port.shape[1]):
        for i in range(first):
            out[i] += push[i, k] * port[ADDED, k]
        if port[UNEVEN, k] == 0.0:
            continue
        uneven = 0.0
        for j in range(len(model.order) - first):
            uneven += model.to_elastic[k, j] * (y[first + j] - model.rest[first + j])
        for i in range(len(model.order) - first):
            out[first + i] += push[i, k] * port[UNEVEN, k] * uneven / 3.0
    share = share_of_all(port)
    if share != 0.0:
        for i in range(first):
            for j in range(first):
                out[i] += share * model.beside[i, j] * (y[j] - model.rest[j])
        for i in range(len(model.order) - first):
            for j in range(len(model.order) - first):
                out[first + i] += share * model.beside[i, j] * (y[first + j] - model.rest[first + j]) / 3.0


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
    m, first = len(model.order), stretching(model)
    rate, gained, loads, push = work[MOVED], work[SEEN], ports[4], model.push
    for i in range(m):
        rate[i] = (y[i] - work[LAST, i]) * per_s
        gained[i] = (rate[i] - work[VELOCITY, i]) * per_s
    _fill_loads(y, rate, per_s, tip_force, model, hooks[1], ports)
    for i in range(m):
        out[i] = model.stiffness[i] * y[i] + model.damping[i] * rate[i] - loads[i]
    add_inertia(y, rate, gained, out, model.inertia, model.order)
    for i in range(m - first):
        k = first + i
        out[i] += model.skewed * y[k] + model.skewed_damping * rate[k]
        out[k] += model.skewed * y[i] + model.skewed_damping * rate[i]
    for i in range(first):
        for k in range(len(pressure)):
            out[i] -= push[i, k] * pressure[k]
    if len(hooks[0][0]) > 0:
        run_body_effects(hooks[0], ports[0], y, model, pressure, strains, dt, False)
        _add_walls(y, out, model, ports[0])
