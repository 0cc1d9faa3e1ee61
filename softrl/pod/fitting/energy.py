"""The condensed elastic energy W(z): a polynomial fitted to values and three derivatives at equilibria.

At an equilibrium the gradient of W is the load and its Hessian is the inverse of the compliance C; the slope of C by the
load gives its third derivative D. With ``r`` coordinates that is one equation for each monomial of degree 3.
"""

import logging
from itertools import combinations_with_replacement, permutations
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from softrl.core.polynomial import basis, multinomials
from softrl.pod.fitting.equilibria import Equilibria

log = logging.getLogger(__name__)
CHUNK, THIRD_CHUNK = 64, 8  # samples in memory at once
MARGIN = 1.15  # the polynomial is trusted this much beyond the farthest sample


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


def accumulate(samples: Equilibria, frame: np.ndarray, scale: Scale, degree: int, weights: Weights) -> Normal:
    """Return the normal equations of ``samples`` for W up to ``degree`` in y.

    Equations are put in units of coordinates by the compliance, ``C (dW/dz - load) = 0``, ``C W'' C - C = 0`` and
    ``D(C, C, C) + dC/dload = 0``, each coordinate and each load over its scale: W is then fitted for the motion that it
    predicts.
    """
    r = len(frame)
    inverse = np.linalg.inv(frame)
    table = basis(r, degree)
    kept = slice(r + 1, None)
    size = table.monomials - r - 1
    normal = Normal(np.zeros((size, size)), np.zeros(size))
    rows_of, columns_of = np.triu_indices(r)
    pair_weight = weights.hessian * scale.load[:, None] / scale.coordinate
    pair_weight = np.sqrt(pair_weight**2 + np.where(np.eye(r, dtype=bool), 0.0, pair_weight.T**2))
    for first in range(0, len(samples.load), CHUNK):
        part = samples.rows(slice(first, first + CHUNK))
        points = part.coordinate @ inverse.T
        to_coordinate = part.compliance @ inverse.T  # dz/dload times dy/dz': maps dW/dy to dz
        gradient = (to_coordinate / scale.coordinate[:, None]) @ table.gradient_rows(points)[..., kept]
        move = np.einsum("sij,sj->si", part.compliance, part.load) / scale.coordinate
        _add(normal, gradient.reshape(-1, size), move.ravel())
        _add(
            normal,
            table.values(points)[:, kept] * (weights.value / scale.energy),
            part.energy * (weights.value / scale.energy),
        )
        bent = np.einsum("ski,sijm->skjm", to_coordinate, table.hessian_rows(points)[..., kept], optimize=True)
        bent = np.einsum("skjm,slj->sklm", bent, to_coordinate, optimize=True)[:, rows_of, columns_of]
        _add(
            normal,
            (bent * pair_weight[rows_of, columns_of, None]).reshape(-1, size),
            (part.compliance[:, rows_of, columns_of] * pair_weight[rows_of, columns_of]).ravel(),
        )
        if weights.third > 0.0:
            triples, triple_weight = _triples(scale, weights.third)
            for row in range(0, len(points), THIRD_CHUNK):
                few = slice(row, row + THIRD_CHUNK)
                turned = table.third_rows(points[few])[..., kept]
                for _ in range(3):  # turns the first of three axes to loads, and puts it last
                    turned = np.einsum("sla,sabcm->sbclm", to_coordinate[few], turned, optimize=True)
                _add(
                    normal,
                    (turned[:, *triples] * triple_weight[:, None]).reshape(-1, size),
                    -(part.slopes["compliance"][few][:, *triples] * triple_weight).ravel(),
                )
    return normal


def _triples(scale: Scale, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the different entries (3, k) of a tensor symmetric in three axes, and the weight (k,) of each.

    An entry stands for all that equal it; a third derivative changes coordinate i by loads j and k.
    """
    triples = np.array(list(combinations_with_replacement(range(len(scale.load)), 3))).T
    whole = (scale.load[:, None] * scale.load / scale.coordinate[:, None, None]) ** 2
    equal = [sum(whole[order] for order in set(permutations(triple))) for triple in triples.T]
    return triples, weight * np.sqrt(equal)


def _add(normal: Normal, rows: np.ndarray, right: np.ndarray) -> None:
    normal.matrix[...] += rows.T @ rows
    normal.right[...] += rows.T @ right


def solve(normal: Normal, order: int, degree: int, ridge: float) -> np.ndarray:
    """Return the coefficients (monomials,) J of W of ``degree`` from equations accumulated to that degree or higher.

    ``ridge`` is relative to the mean diagonal of the equations about the quadratic part. A coefficient is held towards
    zero by the inverse of its multinomial number, which has no preferred direction: powers of a coordinate in which the
    samples are thin stay small, where a ridge relative to each column lets them run wild beyond the samples.
    """
    table = basis(order, degree)
    kept = slice(order + 1, None)
    size = table.monomials - order - 1
    spread = np.sqrt(multinomials(order, degree)[kept])
    scaled = normal.matrix[:size, :size] * spread * spread[:, None]
    quadratic = order * (order + 1) // 2
    scaled[np.diag_indices(size)] += ridge * float(np.trace(scaled[:quadratic, :quadratic])) / quadratic
    factor = cho_factor(scaled, lower=True, overwrite_a=True, check_finite=False)
    return np.r_[np.zeros(order + 1), cho_solve(factor, normal.right[:size] * spread, check_finite=False) * spread]
