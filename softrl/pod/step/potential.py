"""The condensed potential and its derivatives, compiled, inside and outside the samples.

Unknowns are ``y`` with ``z = frame y``. The samples of the model lie in the ball ``|y| <= 1``; outside it the potential
goes on along rays from the origin as its Taylor polynomial of second order at the sphere, and a wall rises,
``wall (|y| - 1)^3``: twice differentiable, and the wall outgrows the rest, so that nothing runs away and the potential
is convex far out. A part P_d of degree d becomes ``w_d(|y|) P_d(y / |y|)``,
``w_d(r) = 1 + d (r - 1) + d (d - 1) (r - 1)^2 / 2``; degrees up to two go on unchanged.
"""

import math
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.reduced_model import SHAPES
from softrl.core.compiled import borrowing, standing, summing


class Tables(NamedTuple):
    """The arrays that the kernels read; ``r = n + 3`` coordinates, k monomials (a count of its own for each map).

    Attributes
    ----------
    frame, inverse : (r, r) z per y and y per z
    parent, variable, degrees : (k,) how monomials are made;  shares : (k,) 1 / (degree + 1)
    gradient : (r, k), hessian : (pairs, k) J, of elastic energy and weight together
    quadratic : (r, r) J, elastic Hessian at rest: what makes an indefinite Newton matrix definite
    amplitudes : (k, m) kg^0.5 m;  amplitude_slope : (k r, m) their gradient, see ``pod.step.inertia``
    stiffness_root : (pairs, k) entries of S, and stiffness_factor : (r, r) L, of viscosity ``L S'S L'``, see ``pod.step.chord``
    weight : (3, r, k) N/(m/s^2) m, mass times the gradient of the centre of mass by y
    rotation : (3, k) rad, rotation vector of the tip;  turn : (3, k) rad, what weight and layers turn it further, as a spin
    turn_by_gravity : (3, 3, k) rad per m/s^2 along each axis, what weight does of ``turn``
    inner_give : (21, k);  inner_rotation : (18, k);  inner_root, drag_root : (6 r + 21, k), see ``ReducedModel``
    rest_volume : (n,) m^3;  rest_tip : (3,) m
    rest_slope : (n,) Pa, pressure per relative volume of one chamber at rest, other volumes held and tip free
    gravity : (3,) m/s^2, contained in gradient and hessian
    scales : (4,) mass scale; mass damping 1/s; stiffness damping s; wall J
    """

    frame: np.ndarray
    inverse: np.ndarray
    parent: np.ndarray
    variable: np.ndarray
    degrees: np.ndarray
    shares: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    quadratic: np.ndarray
    amplitudes: np.ndarray
    amplitude_slope: np.ndarray
    stiffness_root: np.ndarray
    stiffness_factor: np.ndarray
    weight: np.ndarray
    rotation: np.ndarray
    turn: np.ndarray
    turn_by_gravity: np.ndarray
    inner_give: np.ndarray
    inner_root: np.ndarray
    drag_root: np.ndarray
    inner_rotation: np.ndarray
    rest_volume: np.ndarray
    rest_tip: np.ndarray
    rest_slope: np.ndarray
    gravity: np.ndarray
    scales: np.ndarray


class Room(NamedTuple):
    """What the kernels work in, ``r`` coordinates: every function says of which parts it leaves something behind.

    Attributes
    ----------
    values, mixed : (k,) monomials, and polynomials one a monomial;  weighed : (4, k)
    point, middle, former : (r,);  formerly : (6,)
    scratch : (r, r);  root : (r r,);  half, weights : (pairs,)
    """

    values: np.ndarray
    mixed: np.ndarray
    weighed: np.ndarray
    point: np.ndarray
    middle: np.ndarray
    former: np.ndarray
    formerly: np.ndarray
    scratch: np.ndarray
    root: np.ndarray
    half: np.ndarray
    weights: np.ndarray


@nb.njit(cache=True)
def make_room(tables: Any) -> Room:
    """Return the room that a model with ``tables`` needs."""
    r, k = len(tables.frame), len(tables.parent)
    pairs = r * (r + 1) // 2
    return Room(
        np.empty(k), np.empty(k), np.empty((4, k)), np.empty(r), np.empty(r), np.empty(r), np.empty(SHAPES),
        np.empty((r, r)), np.empty(r * r), np.empty(pairs), np.empty(pairs),
    )  # fmt: skip


@borrowing
def fill_monomials(point: np.ndarray, parent: np.ndarray, variable: np.ndarray, values: np.ndarray) -> None:
    """Fill ``values`` with the monomials at ``point``."""
    values[0] = 1.0
    for k in range(1, len(values)):
        values[k] = values[parent[k]] * point[variable[k]]


@borrowing
def to_ball(y: np.ndarray, point: np.ndarray) -> float:
    """Fill ``point`` with the nearest point of the unit ball on the ray to ``y``; return ``|y|``."""
    square = 0.0
    for i in range(len(y)):
        square += y[i] * y[i]
    radius = math.sqrt(square)
    shrink = 1.0 if radius <= 1.0 else 1.0 / radius
    for i in range(len(y)):
        point[i] = y[i] * shrink
    return radius


@summing
def polynomial(coefficients: np.ndarray, values: np.ndarray) -> float:
    """Return one polynomial at monomials ``values``, of which it reads as many as it has coefficients."""
    total = 0.0
    for k in range(len(coefficients)):
        total += coefficients[k] * values[k]
    return total


@summing
def _fill_both(
    coefficients: np.ndarray, values: np.ndarray, shares: np.ndarray, rows: np.ndarray, shared: np.ndarray
) -> None:
    """Fill ``rows`` (m,) with polynomials (m, k) at monomials ``values``, and ``shared`` at ``shares`` (k,) of them.

    Three at a time, the last ones twice where m is no multiple: what they have in common is read once.
    """
    last = len(rows) - 1
    for first in range(0, last + 1, 3):
        m, n = min(first + 1, last), min(first + 2, last)
        a = b = c = d = e = f = 0.0
        for k in range(coefficients.shape[1]):
            a += coefficients[first, k] * values[k]
            b += coefficients[m, k] * values[k]
            c += coefficients[n, k] * values[k]
            d += coefficients[first, k] * shares[k]
            e += coefficients[m, k] * shares[k]
            f += coefficients[n, k] * shares[k]
        rows[first], rows[m], rows[n] = a, b, c
        shared[first], shared[m], shared[n] = d, e, f


@standing
def fill_potential(y: np.ndarray, tables: Any, work: Any, gradient: np.ndarray, hessian: np.ndarray) -> float:
    """Fill gradient (r,) and Hessian (r, r) of the potential at ``y`` in J; return ``|y|``.

    ``work.values`` then holds the monomials at ``work.point``.
    By Euler's theorem the gradient of a part of degree d is its Hessian times ``y / (d - 1)``: one evaluation for both.
    """
    r, values, point = len(y), work.values, work.point
    radius = to_ball(y, point)
    known = tables.hessian.shape[1] if radius <= 1.0 else tables.gradient.shape[1]
    fill_monomials(point, tables.parent, tables.variable, values[: max(known, tables.weight.shape[2])])
    known = tables.hessian.shape[1]
    shares, curves, pulls = work.mixed[:known], work.half, work.weights
    for k in range(known):
        shares[k] = values[k] * tables.shares[k]
    _fill_both(tables.hessian, values, shares, curves, pulls)
    for i in range(r):
        gradient[i] = tables.gradient[i, 0]
    pair = 0
    for i in range(r):
        for j in range(i, r):
            hessian[i, j] = hessian[j, i] = curves[pair]
            gradient[i] += pulls[pair] * point[j]
            if i != j:
                gradient[j] += pulls[pair] * point[i]
            pair += 1
    if radius > 1.0:
        _continue(radius, tables, work, gradient, hessian)
    return radius


@borrowing
def _continue(radius: float, tables: Any, work: Any, gradient: np.ndarray, hessian: np.ndarray) -> None:
    """Turn the derivatives at the sphere's point u, which is ``work.point``, into those at ``radius u``.

    With P_d of degree d, ``f_d(r) = w_d(r) / r^d`` and ``sum f_d(|y|) P_d(y)`` the potential outside; P_d and its
    gradient are tied by ``u.P_d' = d P_d``.
    """
    values, u, side, weighed, curved = work.values, work.point, work.middle, work.weighed[:3], work.weighed[3]
    r, terms, second = len(u), tables.gradient.shape[1], tables.hessian.shape[1]
    for k in range(terms):
        d = tables.degrees[k] + 1.0
        value, slope, bend = _ray(d, radius)
        first = slope - d * value / radius
        weighed[0, k] = value / radius * values[k]
        weighed[1, k] = first * values[k]
        weighed[2, k] = (bend - 2.0 * d * slope / radius + d * (d + 1.0) * value / radius**2) / d * values[k]
    for k in range(second):
        value, _, _ = _ray(tables.degrees[k] + 2.0, radius)
        curved[k] = value / radius**2 * values[k]
    along = bending = 0.0
    for i in range(r):
        side[i] = polynomial(tables.gradient[i], weighed[1]) / radius
        bending += u[i] * polynomial(tables.gradient[i], weighed[2])
        gradient[i] = polynomial(tables.gradient[i], weighed[0])
    for k in range(terms):
        weighed[1, k] /= tables.degrees[k] + 1.0
    for i in range(r):
        along += u[i] * polynomial(tables.gradient[i], weighed[1])
    for i in range(r):
        gradient[i] += along * u[i]
    pair = 0
    for i in range(r):
        for j in range(i, r):
            hessian[i, j] = (
                polynomial(tables.hessian[pair], curved)
                + side[i] * u[j]
                + u[i] * side[j]
                + (bending - along / radius) * u[i] * u[j]
                + (along / radius if i == j else 0.0)
            )
            hessian[j, i] = hessian[i, j]
            pair += 1
    wall, beyond = 3.0 * tables.scales[3], radius - 1.0
    for i in range(r):
        gradient[i] += wall * beyond**2 * u[i]
        hessian[i, i] += wall * beyond**2 / radius
        for j in range(r):
            hessian[i, j] += wall * beyond * (2.0 - beyond / radius) * u[i] * u[j]


@borrowing
def _ray(degree: float, radius: float) -> tuple[float, float, float]:
    """Return w_d and its two derivatives at ``radius``."""
    beyond, bend = radius - 1.0, degree * (degree - 1.0)
    return 1.0 + beyond * (degree + 0.5 * bend * beyond), degree + bend * beyond, bend


@summing
def fill_rows(coefficients: np.ndarray, values: np.ndarray, rows: np.ndarray) -> None:
    """Fill ``rows`` (m,) with the polynomials ``coefficients`` (m, k) at monomials ``values``.

    Four at a time, the last ones twice where m is no multiple: monomials are read once.
    """
    last = len(rows) - 1
    for first in range(0, last + 1, 4):
        m, n, o = min(first + 1, last), min(first + 2, last), min(first + 3, last)
        a = b = c = d = 0.0
        for k in range(coefficients.shape[1]):
            a += coefficients[first, k] * values[k]
            b += coefficients[m, k] * values[k]
            c += coefficients[n, k] * values[k]
            d += coefficients[o, k] * values[k]
        rows[first], rows[m], rows[n], rows[o] = a, b, c, d


@summing
def fill_square(root: np.ndarray, square: np.ndarray) -> None:
    """Fill ``square`` (r, r) with R' R, R row by row in ``root`` (k r,): never indefinite."""
    r = len(square)
    for i in range(r):
        for j in range(i, r):
            total = 0.0
            for k in range(len(root) // r):
                total += root[k * r + i] * root[k * r + j]
            square[i, j] = total
            square[j, i] = total


@summing
def square_of(matrix: np.ndarray, vector: np.ndarray) -> float:
    """Return vector' matrix vector."""
    total = 0.0
    for i in range(len(vector)):
        for j in range(len(vector)):
            total += vector[i] * matrix[i, j] * vector[j]
    return total
