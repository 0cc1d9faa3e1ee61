"""Polynomial maps of the reduced coordinates: roots of mass and stiffness, centre of mass, rotation of the tip."""

from collections.abc import Sequence
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


class Normal(NamedTuple):
    """The equations of a map of polynomials of one degree, scaled monomials, ready for any ridge."""

    matrix: np.ndarray
    right: np.ndarray
    total_weight: float
    scale: np.ndarray
    skip: int

    def solve(self, ridge: float) -> np.ndarray:
        """Return the coefficients (columns, monomials); ``ridge`` is relative to the sum of the weights."""
        matrix = self.matrix + ridge * self.total_weight * np.eye(len(self.matrix))
        found = np.linalg.solve(matrix, self.right) * self.scale[:, None]
        return np.pad(found.T, ((0, 0), (self.skip, 0)))


def equations(seen: Seen, targets: np.ndarray, weight: np.ndarray, degree: int, through_origin: bool) -> Normal:
    """Return the equations of polynomials with ``targets`` (S, 1 + k, columns) where they are seen.

    ``weight`` (S,) is that of each sample's squares. ``through_origin`` leaves out the constant term: the map of rest is
    zero.
    """
    spread = np.sqrt(multinomials(seen.points.shape[1], degree))
    skip = 1 if through_origin else 0
    rows = (seen.design(degree) * spread)[..., skip:]
    scaled, equal = rows.reshape(-1, rows.shape[2]), targets.reshape(-1, targets.shape[2])
    weighed = scaled * np.repeat(weight, rows.shape[1])[:, None]
    return Normal(weighed.T @ scaled, weighed.T @ equal, float(weight.sum()), spread[skip:], skip)


class Form(NamedTuple):
    """A degree and a ridge, and their mean squared error over folds that the fit did not see."""

    degree: int
    ridge: float
    error: float


def best_form(
    seen: Seen, targets: np.ndarray, weight: np.ndarray, fold: np.ndarray, judged: slice, degree_max: int,
    through_origin: bool, ridges: Sequence[float],
) -> Form:
    """Return the degree up to ``degree_max`` and the ridge whose error over folds that the fit did not see is smallest.

    ``weight`` (S,) is that of each sample in the fits, ``fold`` (S,) numbers its part; the error is that of the rows
    ``judged``. A degree with more monomials than equations is not tried.
    """
    tried: list[Form] = []
    for degree in range(1 if through_origin else 0, degree_max + 1):
        if tried and count(seen.points.shape[1], degree) > 0.7 * targets.shape[0] * targets.shape[1]:
            break
        left = np.empty((len(ridges), *targets.shape))
        for part in np.unique(fold):
            inside = fold != part
            normal = equations(seen.rows(inside), targets[inside], weight[inside], degree, through_origin)
            design = seen.rows(~inside).design(degree)
            for k, ridge in enumerate(ridges):
                left[k, ~inside] = design @ normal.solve(ridge).T
        errors = ((left - targets)[:, judged] ** 2).mean(axis=(1, 2, 3))
        tried += [Form(degree, ridge, float(error)) for ridge, error in zip(ridges, errors, strict=True)]
    return min(tried, key=lambda form: form.error)


def symmetric_roots(matrices: np.ndarray) -> np.ndarray:
    """Return the symmetric roots (S, r, r) of symmetric ``matrices``, negative parts left out; smooth near identity."""
    values, vectors = np.linalg.eigh(matrices)
    return np.einsum("sik,sk,sjk->sij", vectors, np.sqrt(values.clip(min=0.0)), vectors)
