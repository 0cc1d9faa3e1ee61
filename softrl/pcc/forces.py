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
)
from softrl.pcc.pose import shape_functions

# columns of the work array that one step fills
LAST, VELOCITY, TRIAL, RESIDUAL, STEP, OTHER, NEXT, MOVED, SEEN = range(9)


@summing
def run_load_effects(hook: Any, port: np.ndarray, gravity: np.ndarray, tips: np.ndarray, dt: float, commit: bool) -> None:
    """Fill the load port at the tip ``tips[1]`` and run the effects on it."""
    for k in range(3):
        port[TIP, k] = tips[1, k]
        port[TIP_VELOCITY, k] = (tips[1, k] - tips[0, k]) / dt
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
    per_s, m = 1.0 / dt, len(y)
    for c in range(len(pressure)):
        strain = elastic = 0.0
        for j in range(m):
            moved = y[j] - rest[j]
            strain += to_strain[c, j] * moved
            elastic += to_elastic[c, j] * moved
        stiff = slope[c]
        port[STRAIN, c], port[RATE, c] = strain, (strain - strains[c]) * per_s
        port[ELASTIC, c], port[ELASTIC_SLOPE, c] = elastic, stiff
        port[PRESSURE, c], port[REST, c] = pressure[c], stiff
        port[ADDED, c], port[ADDED_SLOPE, c] = 0.0, 0.0
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
    tips: np.ndarray,
) -> None:
    """Fill ``out`` (m,) with inertia + damping + elasticity + effects - pressure - loads at ``y``, in J.

    The coordinates change from ``work[LAST]``, their rates from ``work[VELOCITY]`` and the tip from ``tips[0]`` at ``per_s``, and
    load effects with them; the body's effects act over ``dt`` from the beginning of the step.
    """
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
        run_load_effects(load_hook, port, gravity, tips, 1.0 / per_s, False)
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
    for i in range(m):
        rate = (y[i] - work[LAST, i]) * per_s
        out[i] = (
            stiffness[i] * y[i]
            + damping[i] * rate
            + mass[i] * (rate - work[VELOCITY, i]) * per_s
            - basis[0, i] * q0
            - basis[1, i] * q1
            - basis[2, i] * q2
        )
    if len(body_hook[0]) == 0:
        for i in range(m):
            total = out[i]
            for c in range(len(pressure)):
                total -= push[i, c] * pressure[c]
            out[i] = total
        return
    run_body_effects(body_hook, ports[0], y, model, pressure, strains, dt, False)
    added = ports[0][ADDED]
    for i in range(m):
        total = out[i]
        for c in range(len(pressure)):
            total += push[i, c] * (added[c] - pressure[c])
        out[i] = total
