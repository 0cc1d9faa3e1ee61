"""Effects inside a step of the energy ROM: what they see of the body, and what they add to its balance."""

from typing import Any

import numba as nb
import numpy as np

from softrl.effects.effect import (
    ADDED,
    ADDED_SLOPE,
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
from softrl.pod.linear import solve_positive
from softrl.pod.potential import polynomial

PROBE = 1e-4  # of the stiffness scale: change of the elastic pressure by which effects are probed




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
