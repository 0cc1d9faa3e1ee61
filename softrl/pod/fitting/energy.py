"""The condensed elastic energy W(z): a polynomial fitted to values and three derivatives at equilibria.

At an equilibrium the gradient of W is the load and its Hessian is the inverse of the compliance C; the slope of C by the
load gives its third derivative D. With ``r`` coordinates that is one equation for each monomial of degree 3.
"""

from collections.abc import Iterable, Iterator
from itertools import combinations_with_replacement, permutations
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from softrl.core.errors import ConfigError
from softrl.core.polynomial import basis, count, multinomials
from softrl.pod.fitting.equilibria import Equilibria
from softrl.pod.fitting.maps import LEAST_RIDGE, ROUNDS, SURPLUS, cauchy, how_odd

CHUNK = 8  # samples worked on at once
MARGIN = 1.15  # the polynomial is trusted this much beyond the farthest sample
USUAL = 3.0  # an error of so many times the usual one counts half


class Weights(NamedTuple):
    """Weight of an equation about a value, a Hessian and a third derivative, relative to one about a gradient."""

    value: float
    hessian: float
    third: float


class Normal(NamedTuple):
    """Least squares accumulated: ``matrix`` (k, k) and ``right`` (k,) over all monomials of degree 2 and higher."""

    matrix: np.ndarray
    right: np.ndarray


class Scale(NamedTuple):
    """What errors are measured in: rms coordinate (r,) m^3 and m, largest load (r,) Pa and N, rms energy J."""

    coordinate: np.ndarray
    load: np.ndarray
    energy: float


def scale_of(samples: Equilibria) -> Scale:
    """Return the scales of ``samples``, about rest."""
    return Scale(
        np.sqrt((samples.coordinate**2).mean(axis=0)),
        np.abs(samples.load).max(axis=0),
        float(np.sqrt((samples.energy**2).mean())),
    )


def frame_of(samples: Equilibria) -> np.ndarray:
    """Return the frame (r, r): each coordinate over its largest value, all samples in the ball of radius 1 / MARGIN.

    Notes
    -----
    Volumes and tip nearly depend on each other, so the samples are thin in some directions. Whitening those makes
    unseen equilibria a little outside the samples wrong by millimetres: high powers of a whitened thin coordinate run
    wild. In this frame they stay small.
    """
    largest = np.abs(samples.coordinate).max(axis=0)
    radius = np.linalg.norm(samples.coordinate / largest, axis=1).max()
    return np.diag(MARGIN * radius * largest)


class Rows(NamedTuple):
    """Equations of a few samples: ``matrix`` (s, e, k) over all monomials of degree 2 and higher, and ``right`` (s, e)."""

    matrix: np.ndarray
    right: np.ndarray


def accumulate(
    samples: Equilibria, weight: np.ndarray, frame: np.ndarray, scale: Scale, degree: int, weights: Weights
) -> Normal:
    """Return the normal equations of ``samples`` for W up to ``degree`` in y; ``weight`` (S,) is that of each one's squares."""
    return _sum(_equations(samples, frame, scale, degree, weights), weight, _unknowns(len(frame), degree))


def trust(samples: Equilibria, frame: np.ndarray, scale: Scale, degree: int, weights: Weights) -> np.ndarray:
    """Return how far (S,), at most 1, a fit of W up to ``degree`` trusts each of ``samples``, see ``maps.trust``.

    Poses far beyond what the robot reaches are needed, for motion may lead there, but no polynomial follows all of them, and
    alike they would bend it everywhere. What is asked is how far the gradient misses their loads.
    """
    r = len(frame)
    while degree > 2 and count(r, degree) > SURPLUS * len(samples.load) * _equations_each(r, weights):
        degree -= 1
    kept = list(_equations(samples, frame, scale, degree, weights))
    trusted = np.ones(len(samples.load))
    for _ in range(ROUNDS):
        found = solve(_sum(kept, trusted, _unknowns(r, degree)), r, degree, LEAST_RIDGE)[r + 1 :]
        missed = [rows.matrix[:, :r] @ found - rows.right[:, :r] for rows in kept]
        trusted = cauchy(how_odd((np.concatenate(missed) ** 2).mean(axis=1)), USUAL)
    return trusted


def _unknowns(r: int, degree: int) -> int:
    """Return the number of monomials of degree 2 and higher, up to ``degree``."""
    return count(r, degree) - r - 1


def _equations_each(r: int, weights: Weights) -> int:
    """Return how many equations a sample gives: gradient, value, and the different entries of Hessian and third derivative."""
    return r + 1 + r * (r + 1) // 2 + (r * (r + 1) * (r + 2) // 6 if weights.third > 0.0 else 0)


def _equations(
    samples: Equilibria, frame: np.ndarray, scale: Scale, degree: int, weights: Weights
) -> Iterator[Rows]:
    """Yield the equations of a few samples after the other, those about the gradient first.

    They are in units of coordinates by the compliance, ``C (dW/dz - load) = 0``, ``C W'' C - C = 0`` and
    ``D(C, C, C) + dC/dload = 0``, each coordinate and each load over its scale: W is then fitted for the motion that it
    predicts.
    """
    r = len(frame)
    inverse = np.linalg.inv(frame)
    table = basis(r, degree)
    kept = slice(r + 1, None)
    rows_of, columns_of = np.triu_indices(r)
    pair_weight = weights.hessian * scale.load[:, None] / scale.coordinate
    pair_weight = np.sqrt(pair_weight**2 + np.where(np.eye(r, dtype=bool), 0.0, pair_weight.T**2))[rows_of, columns_of]
    triples, triple_weight = _triples(scale, weights.third)
    for first in range(0, len(samples.load), CHUNK):
        part = samples.rows(slice(first, first + CHUNK))
        points = part.coordinate @ inverse.T
        to_coordinate = part.compliance @ inverse.T  # dz/dload times dy/dz': maps dW/dy to dz
        gradient = (to_coordinate / scale.coordinate[:, None]) @ table.gradient_rows(points)[..., kept]
        move = np.einsum("sij,sj->si", part.compliance, part.load) / scale.coordinate
        bent = np.einsum("ski,sijm->skjm", to_coordinate, table.hessian_rows(points)[..., kept], optimize=True)
        bent = np.einsum("skjm,slj->sklm", bent, to_coordinate, optimize=True)[:, rows_of, columns_of]
        value = weights.value / scale.energy
        matrices = [gradient, table.values(points)[:, None, kept] * value, bent * pair_weight[:, None]]
        rights = [move, part.energy[:, None] * value, part.compliance[:, rows_of, columns_of] * pair_weight]
        if weights.third > 0.0:
            turned = table.third_rows(points)[..., kept]
            for _ in range(3):  # turns the first of three axes to loads, and puts it last
                turned = np.einsum("sla,sabcm->sbclm", to_coordinate, turned, optimize=True)
            matrices.append(turned[:, *triples] * triple_weight[:, None])
            rights.append(-part.slopes["compliance"][:, *triples] * triple_weight)
        yield Rows(np.concatenate(matrices, axis=1), np.concatenate(rights, axis=1))


def _sum(equations: Iterable[Rows], weight: np.ndarray, size: int) -> Normal:
    """Return the normal equations of ``equations`` in ``size`` unknowns, ``weight`` (S,) being that of each sample's squares."""
    normal, root, first = Normal(np.zeros((size, size)), np.zeros(size)), np.sqrt(weight), 0
    for rows in equations:
        each = root[first : first + len(rows.right), None]
        matrix, right = (rows.matrix * each[..., None]).reshape(-1, size), (rows.right * each).ravel()
        normal.matrix[...] += matrix.T @ matrix
        normal.right[...] += matrix.T @ right
        first += len(rows.right)
    return normal


def _triples(scale: Scale, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the different entries (3, k) of a tensor symmetric in three axes, and the weight (k,) of each.

    An entry stands for all that equal it; a third derivative changes coordinate i by loads j and k.
    """
    triples = np.array(list(combinations_with_replacement(range(len(scale.load)), 3))).T
    whole = (scale.load[:, None] * scale.load / scale.coordinate[:, None, None]) ** 2
    equal = [sum(whole[order] for order in set(permutations(triple))) for triple in triples.T]
    return triples, weight * np.sqrt(equal)


def solve(normal: Normal, order: int, degree: int, ridge: float) -> np.ndarray:
    """Return the coefficients (monomials,) J of W of ``degree`` from equations accumulated to that degree or higher.

    ``ridge`` is relative to the mean diagonal of the equations about the quadratic part. A coefficient is held towards
    zero by the inverse of its multinomial number, which has no preferred direction: powers of a coordinate in which the
    samples are thin stay small, where a ridge relative to each column lets them run wild beyond the samples.

    Raises
    ------
    ConfigError
        If the equations leave something open, and the ridge is less than round-off.
    """
    table = basis(order, degree)
    kept = slice(order + 1, None)
    size = table.monomials - order - 1
    spread = np.sqrt(multinomials(order, degree)[kept])
    scaled = normal.matrix[:size, :size] * spread * spread[:, None]
    quadratic = order * (order + 1) // 2
    scaled[np.diag_indices(size)] += ridge * float(np.trace(scaled[:quadratic, :quadratic])) / quadratic
    try:
        factor = cho_factor(scaled, lower=True, overwrite_a=True, check_finite=False)
    except LinAlgError as singular:
        raise ConfigError(
            f"stage.ridges: {ridge:g} is less than round-off in an energy of degree {degree}; choose larger ones, or run "
            "stage=fem with more equilibria"
        ) from singular
    return np.r_[np.zeros(order + 1), cho_solve(factor, normal.right[:size] * spread, check_finite=False) * spread]
