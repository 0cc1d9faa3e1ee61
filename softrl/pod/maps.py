"""Polynomial maps of the reduced coordinates: roots of mass and stiffness, centre of mass, rotation of the tip."""

from typing import NamedTuple

import numpy as np

from softrl.pod.polynomial import basis, count, degree_of, multinomials


def fit_map(
    points: np.ndarray, targets: np.ndarray, weight: np.ndarray, degree: int, through_origin: bool, ridge: float
) -> np.ndarray:
    """Return coefficients (columns, monomials) of polynomials from ``points`` (S, r) to ``targets`` (S, columns).

    ``weight`` (S,) is that of each sample's squares; ``ridge`` is relative to their sum. ``through_origin`` leaves out
    the constant term: the map of rest is zero.
    """
    spread = np.sqrt(multinomials(points.shape[1], degree))
    skip = 1 if through_origin else 0
    scaled = (basis(points.shape[1], degree).values(points) * spread)[:, skip:]
    weighed = scaled * weight[:, None]
    normal = weighed.T @ scaled + ridge * weight.sum() * np.eye(scaled.shape[1])
    found = np.linalg.solve(normal, weighed.T @ targets) * spread[skip:, None]
    return np.pad(found.T, ((0, 0), (skip, 0)))


def evaluate(coefficients: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the polynomials ``coefficients`` (columns, monomials) at ``points`` (S, r), (S, columns)."""
    r = points.shape[1]
    return basis(r, degree_of(r, coefficients.shape[1])).values(points) @ coefficients.T


class Degree(NamedTuple):
    """A degree, and its mean squared error over folds that the fit did not see."""

    degree: int
    error: float


def best_degree(
    points: np.ndarray, targets: np.ndarray, weight: np.ndarray, fold: np.ndarray, judged: slice, degree_max: int,
    through_origin: bool, ridge: float,
) -> Degree:
    """Return the degree up to ``degree_max`` whose error over folds that the fit did not see is smallest.

    ``weight`` (S,) is that of each sample in the fits, ``fold`` (S,) numbers its part; the error is that of the rows
    ``judged``. A degree with more monomials than samples is not tried.
    """
    errors: dict[int, float] = {}
    for degree in range(1 if through_origin else 0, degree_max + 1):
        if errors and count(points.shape[1], degree) > 0.7 * len(points):
            break
        left = np.empty_like(targets)
        for part in np.unique(fold):
            seen = fold != part
            left[~seen] = evaluate(
                fit_map(points[seen], targets[seen], weight[seen], degree, through_origin, ridge), points[~seen]
            )
        errors[degree] = float(((left - targets)[judged] ** 2).mean())
    best = min(errors, key=lambda degree: errors[degree])
    return Degree(best, errors[best])


def symmetric_roots(matrices: np.ndarray) -> np.ndarray:
    """Return the symmetric roots (S, r, r) of symmetric ``matrices``, negative parts left out; smooth near identity."""
    values, vectors = np.linalg.eigh(matrices)
    return np.einsum("sik,sk,sjk->sij", vectors, np.sqrt(values.clip(min=0.0)), vectors)


def elastic_factors(hessian: np.ndarray) -> np.ndarray:
    """Return upper triangular U (S, r, r) with U U' the ``hessian``, as ``pod.potential.fill_elastic_factor`` does."""
    return np.linalg.cholesky(hessian[..., ::-1, ::-1])[..., ::-1, ::-1]
