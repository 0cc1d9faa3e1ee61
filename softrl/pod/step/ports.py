"""Effects inside a step of the energy ROM: what they see of the body, and what they add to its balance."""

from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.core.compiled import borrowing, summing
from softrl.effects.call import run_ports
from softrl.effects.port import (
    ADDED,
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
    body_port,
    clear,
    share_of_all,
    slope_of,
)
from softrl.pod.step.potential import polynomial

PROBE = 1e-4  # of the stiffness scale: change of the elastic pressure by which effects are probed


class Ports(NamedTuple):
    """What effects see, and room to work in; made once for a run.

    Attributes
    ----------
    body, load : as in ``effects.port``
    strains, tips : (2, n), (2, 3) m, at the last step and at the trial
    elastic, settled : (r,) gradient by y of the elastic energy, less ``settled``, which it is where strains count from
    slopes, half : (r, r) Hessian by z, and scratch
    shares : (2, n) derivative of the added pressure by the elastic one, and the added pressure in Pa
    """

    body: np.ndarray
    load: np.ndarray
    strains: np.ndarray
    tips: np.ndarray
    elastic: np.ndarray
    settled: np.ndarray
    slopes: np.ndarray
    half: np.ndarray
    shares: np.ndarray


@nb.njit(cache=True)
def make_ports(n: int) -> Ports:
    """Return the ports of a body with ``n`` chambers."""
    r = n + 3
    return Ports(
        body_port(n),
        np.zeros((LOAD_PORT_ROWS, 3)),
        np.zeros((2, n)),
        np.zeros((2, 3)),
        np.zeros(r),
        np.zeros(r),
        np.zeros((r, r)),
        np.zeros((r, r)),
        np.zeros((2, n)),
    )


@borrowing
def fill_elastic(gradient: np.ndarray, tables: Any, values: np.ndarray, ports: Any) -> None:
    """Fill ``ports.elastic`` from the ``gradient`` (r,) of elastic energy and weight, at the monomials ``values``."""
    elastic = ports.elastic
    for j in range(len(gradient)):
        elastic[j] = gradient[j] - ports.settled[j]
    for a in range(3):
        if tables.gravity[a] != 0.0:
            for j in range(len(gradient)):
                elastic[j] += tables.gravity[a] * polynomial(tables.weight[a, j], values)


@borrowing
def fill_ports(
    y: np.ndarray,
    rest: np.ndarray,
    gradient: np.ndarray,
    hessian: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tables: Any,
    ports: Any,
    slopes: bool,
) -> None:
    """Fill the inputs of both ports from the bare body's trial state, and ``ports.elastic``; trial strains and tip go to row 1.

    The slope of the elastic pressure is found anew where ``slopes`` asks for it: it only speeds the iteration.
    """
    body, load, strains, tips = ports.body, ports.load, ports.strains, ports.tips
    n, r = len(pressure), len(y)
    if slopes:
        _hessian_of_coordinate(hessian, tables.inverse, ports.half, ports.slopes)
        for i in range(n):
            body[ELASTIC_SLOPE, i] = _slope(ports.slopes, n, i) * tables.rest_volume[i]
    for i in range(n):
        strain = elastic = 0.0
        for j in range(r):
            strain += tables.frame[i, j] * (y[j] - rest[j])
            elastic += tables.inverse[j, i] * ports.elastic[j]
        strains[1, i] = strain / tables.rest_volume[i]
        body[STRAIN, i], body[RATE, i] = strains[1, i], (strains[1, i] - strains[0, i]) / dt
        body[ELASTIC, i], body[PRESSURE, i], body[REST, i] = elastic, pressure[i], tables.rest_slope[i]
    clear(body)
    for k in range(3):
        tips[1, k] = tables.rest_tip[k]
        for j in range(r):
            tips[1, k] += tables.frame[n + k, j] * y[j]
        load[TIP, k], load[TIP_VELOCITY, k] = tips[1, k], (tips[1, k] - tips[0, k]) / dt
        load[GRAVITY, k] = tables.gravity[k]
        for row in range(FORCE, LOAD_PORT_ROWS):
            load[row, k] = 0.0


@summing
def _hessian_of_coordinate(hessian: np.ndarray, inverse: np.ndarray, half: np.ndarray, out: np.ndarray) -> None:
    """Fill ``out`` with the Hessian by z of what has ``hessian`` by y; ``half`` is scratch."""
    r = len(hessian)
    for i in range(r):
        for j in range(r):
            total = 0.0
            for k in range(r):
                total += hessian[i, k] * inverse[k, j]
            half[i, j] = total
    for i in range(r):
        for j in range(i, r):
            total = 0.0
            for k in range(r):
                total += inverse[k, i] * half[k, j]
            out[i, j] = total
            out[j, i] = total


@borrowing
def _slope(hessian: np.ndarray, n: int, chamber: int) -> float:
    """Return d pressure / d volume of one chamber, other volumes held and tip free, from the Hessian by z."""
    a, b, c = hessian[n, n], hessian[n, n + 1], hessian[n, n + 2]
    d, e, f = hessian[n + 1, n + 1], hessian[n + 1, n + 2], hessian[n + 2, n + 2]
    u, v, w = hessian[n, chamber], hessian[n + 1, chamber], hessian[n + 2, chamber]
    minor = a * d - b * b
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    if not (a > 0.0 and minor > 0.0 and determinant > 0.0):
        return hessian[chamber, chamber]
    squares = u * u * (d * f - e * e) + v * v * (a * f - c * c) + w * w * minor
    products = u * v * (c * e - b * f) + u * w * (b * e - c * d) + v * w * (b * c - a * e)
    return hessian[chamber, chamber] - (squares + 2.0 * products) / determinant


@borrowing
def commit_effects(
    y: np.ndarray,
    rest: np.ndarray,
    gradient: np.ndarray,
    hessian: np.ndarray,
    dt: float,
    pressure: np.ndarray,
    tables: Any,
    hooks: Any,
    ports: Any,
    values: np.ndarray,
) -> None:
    """Let the effects take the trial state as the state; ``gradient`` and ``hessian`` are the bare body's."""
    if len(hooks[0].kernels) > 0:
        fill_elastic(gradient, tables, values, ports)
    fill_ports(y, rest, gradient, hessian, dt, pressure, tables, ports, False)
    run_ports(hooks[0], ports.body, dt, True)
    run_ports(hooks[1], ports.load, dt, True)
    go_on(ports)


@borrowing
def go_on(ports: Any) -> None:
    """Take the trial strains and tip as those of the last step."""
    for seen in (ports.strains, ports.tips):
        for i in range(seen.shape[1]):
            seen[0, i] = seen[1, i]


@borrowing
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
    values: np.ndarray,
    jacobian: np.ndarray,
    probe: bool,
) -> None:
    """Add the effects' reaction to ``gradient`` (r,) and its derivative to ``jacobian`` (r, r).

    ``gradient`` and ``hessian`` are the bare body's on entry. An effect may answer to the elastic pressure, which
    depends on all coordinates: that share is found by a second call with the elastic pressure raised, where ``probe``
    asks for it, else it is the share found last. It speeds Newton's iteration and does not change its end.
    """
    if len(hooks[0].kernels) > 0:
        fill_elastic(gradient, tables, values, ports)
    fill_ports(y, rest, gradient, hessian, dt, pressure, tables, ports, probe)
    if len(hooks[0].kernels) > 0:
        _add_body(gradient, hessian, dt, tables, hooks[0], ports, jacobian, probe)
    if len(hooks[1].kernels) > 0:
        _add_load(gradient, dt, tables, hooks[1], ports, values, jacobian)


@borrowing
def _add_body(
    gradient: np.ndarray,
    hessian: np.ndarray,
    dt: float,
    tables: Any,
    calls: Any,
    ports: Any,
    jacobian: np.ndarray,
    probe: bool,
) -> None:
    body, shares, slopes = ports.body, ports.shares, ports.half
    n, r = body.shape[1], len(gradient)
    run_ports(calls, body, dt, False)
    share = share_of_all(body)
    if share != 0.0:
        _add_beside(gradient, hessian, tables, ports, jacobian, share)
    for i in range(n):
        shares[1, i] = body[ADDED, i]
        for c in range(n):
            slopes[i, c] = slope_of(body, i, c) / tables.rest_volume[c]
    if probe:
        for i in range(n):
            body[ELASTIC, i] += PROBE * tables.rest_slope[i]
        clear(body)
        run_ports(calls, body, dt, False)
        for i in range(n):
            shares[0, i] = (body[ADDED, i] - shares[1, i]) / (PROBE * tables.rest_slope[i])
    for i in range(n):
        slopes[i, i] -= shares[0, i] * body[ELASTIC_SLOPE, i] / tables.rest_volume[i]
        for j in range(r):
            gradient[j] += tables.frame[i, j] * shares[1, i]
        for k in range(r):
            slope = 0.0
            for c in range(n):
                slope += slopes[i, c] * tables.frame[c, k]
            if shares[0, i] != 0.0:
                for j in range(r):
                    slope += shares[0, i] * tables.inverse[j, i] * hessian[j, k]
            for j in range(r):
                jacobian[j, k] += tables.frame[i, j] * slope


@borrowing
def _add_beside(
    gradient: np.ndarray, hessian: np.ndarray, tables: Any, ports: Any, jacobian: np.ndarray, share: float
) -> None:
    """Add the ``share`` of what the bare body resists where its tip moves and its chambers do not."""
    n, r, tip = ports.body.shape[1], len(gradient), ports.half[1]
    for a in range(3):
        tip[a] = 0.0
        for k in range(r):
            tip[a] += tables.inverse[k, n + a] * ports.elastic[k]
    for a in range(3):
        for j in range(r):
            gradient[j] += share * tables.frame[n + a, j] * tip[a]
        for k in range(r):
            slope = 0.0
            for i in range(r):
                slope += tables.inverse[i, n + a] * hessian[i, k]
            for j in range(r):
                jacobian[j, k] += share * tables.frame[n + a, j] * slope


@borrowing
def _add_load(
    gradient: np.ndarray, dt: float, tables: Any, calls: Any, ports: Any, values: np.ndarray, jacobian: np.ndarray
) -> None:
    load, r = ports.load, len(gradient)
    n = r - 3
    run_ports(calls, load, dt, False)
    for a in range(3):
        tilt = load[GRAVITY, a] - tables.gravity[a]
        for j in range(r):
            gradient[j] -= tables.frame[n + a, j] * load[FORCE, a]
            if tilt != 0.0:
                gradient[j] -= tilt * polynomial(tables.weight[a, j], values)
            for k in range(r):
                for b in range(3):
                    jacobian[j, k] -= tables.frame[n + a, j] * load[FORCE_SLOPE + a, b] * tables.frame[n + b, k]
