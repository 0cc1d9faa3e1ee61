"""Polynomial maps of the reduced coordinates: roots of mass and stiffness, centre of mass, rotation of the tip."""

from typing import NamedTuple

import numpy as np

from softrl.pod.polynomial import basis, count, multinomials


class Seen(NamedTuple):
    """Where a map is seen: at ``points`` (S, r), and how it changes along ``moves`` (S, r, k), of which there may be none."""

    points: np.ndarray
    moves: np.ndarray

    def rows(self, index: np.ndarray | slice) -> "Seen":
        """Return the samples ``index``."""
        return Seen(self.points[index], self.moves[index])

    def design(self, degree: int) -> np.ndarray:
        """Return (S, 1 + k, monomials): the value of every monomial, then its change along each move."""
        table = basis(self.points.shape[1], degree)
        values = table.values(self.points)[:, None]
        if not self.moves.shape[2]:
            return values
        change = np.einsum("srm,srk->skm", table.gradient_rows(self.points), self.moves, optimize=True)
        return np.concatenate([values, change], axis=1)


def fit_map(
    seen: Seen, targets: np.ndarray, weight: np.ndarray, degree: int, through_origin: bool, ridge: float
) -> np.ndarray:
    """Return coefficients (columns, monomials) of polynomials with ``targets`` (S, 1 + k, columns) where they are seen.

    ``weight`` (S,) is that of each sample's squares; ``ridge`` is relative to their sum. ``through_origin`` leaves out
    the constant term: the map of rest is zero.
    """
    spread = np.sqrt(multinomials(seen.points.shape[1], degree))
    skip = 1 if through_origin else 0
    rows = (seen.design(degree) * spread)[..., skip:]
    scaled, equal = rows.reshape(-1, rows.shape[2]), targets.reshape(-1, targets.shape[2])
    weighed = scaled * np.repeat(weight, rows.shape[1])[:, None]
    normal = weighed.T @ scaled + ridge * weight.sum() * np.eye(scaled.shape[1])
    found = np.linalg.solve(normal, weighed.T @ equal) * spread[skip:, None]
    return np.pad(found.T, ((0, 0), (skip, 0)))


class Degree(NamedTuple):
    """A degree, and its mean squared error over folds that the fit did not see."""

    degree: int
    error: float


def best_degree(
    seen: Seen, targets: np.ndarray, weight: np.ndarray, fold: np.ndarray, judged: slice, degree_max: int,
    through_origin: bool, ridge: float,
) -> Degree:
    """Return the degree up to ``degree_max`` whose error over folds that the fit did not see is smallest.

    ``weight`` (S,) is that of each sample in the fits, ``fold`` (S,) numbers its part; the error is that of the rows
    ``judged``. A degree with more monomials than equations is not tried.
    """
    errors: dict[int, float] = {}
    for degree in range(1 if through_origin else 0, degree_max + 1):
        if errors and count(seen.points.shape[1], degree) > 0.7 * targets.shape[0] * targets.shape[1]:
            break
        left = np.empty_like(targets)
        for part in np.unique(fold):
            inside = fold != part
            found = fit_map(seen.rows(inside), targets[inside], weight[inside], degree, through_origin, ridge)
            left[~inside] = seen.rows(~inside).design(degree) @ found.T
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
