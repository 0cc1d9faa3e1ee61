"""Polynomial maps of the reduced coordinates: roots of mass and stiffness, centre of mass, rotation of the tip."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from softrl.core.polynomial import basis, count, multinomials

ALWAYS = -1  # the fold of samples that no fit leaves out
ROUNDS, USUAL = 5, 1.5  # of weights; an error of so many times the usual one counts half
LEAST_RIDGE = 1e-8  # of the fits that tell what is usual
SURPLUS = 0.5  # coefficients an equation there at most: a map that meets every sample tells nothing
ENOUGH = 0.7  # likewise of every other fit
TINY = np.finfo(float).tiny


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
        found = cho_solve(cho_factor(matrix, overwrite_a=True, check_finite=False), self.right, check_finite=False)
        return np.pad((found * self.scale[:, None]).T, ((0, 0), (self.skip, 0)))


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


def trust(
    seen: Seen, targets: Mapping[str, np.ndarray], weight: np.ndarray, degree_max: Mapping[str, int], through_origin: bool
) -> np.ndarray:
    """Return how far (S,), at most 1, a fit trusts each sample: less where the maps of highest degree err far more than usual.

    A chamber that is all but emptied folds its walls, which no polynomial follows: squares of such errors outweigh all
    others, and the maps would be wrong everywhere. These are Cauchy's weights, iterated; the usual error of a map is its median.
    """
    samples, equal = next(iter(targets.values())).shape[:2]
    by_degree: dict[int, list[str]] = {}
    for name, degree in degree_max.items():
        while degree > 1 and count(seen.points.shape[1], degree) > SURPLUS * samples * equal:
            degree -= 1
        by_degree.setdefault(degree, []).append(name)
    trusted = np.ones(samples)
    for _ in range(ROUNDS):
        odd = np.zeros(samples)
        for degree, names in by_degree.items():
            goal = np.concatenate([targets[name] for name in names], axis=2)
            found = equations(seen, goal, weight * trusted, degree, through_origin).solve(LEAST_RIDGE)
            for part in _apart((seen.design(degree) @ found.T - goal) ** 2, targets, names):
                squares = part.mean(axis=(1, 2))
                odd += how_odd(squares) / len(targets)
        trusted = cauchy(odd, USUAL)
    return trusted


def how_odd(squares: np.ndarray) -> np.ndarray:
    """Return squared errors (S,) over the usual one, their median."""
    return np.asarray(squares / max(float(np.median(squares)), TINY))


def cauchy(odd: np.ndarray, usual: float) -> np.ndarray:
    """Return Cauchy's weights (S,): a half where an error is ``usual`` times the usual one."""
    return np.asarray(1.0 / (1.0 + odd / usual**2))


def best_forms(
    seen: Seen, targets: Mapping[str, np.ndarray], weight: np.ndarray, fold: np.ndarray, judged: slice,
    degree_max: Mapping[str, int], through_origin: bool, ridges: Sequence[float],
) -> dict[str, Form]:
    """Return for each map the degree up to its largest and the ridge whose error over folds that the fit did not see is least.

    ``weight`` (S,) is that of each sample in the fits, ``fold`` (S,) numbers its part; the error is the weighed one of the rows
    ``judged``. A degree with more monomials than equations is not tried. All maps are fitted at once.
    """
    best: dict[str, Form] = {}
    samples, equal = next(iter(targets.values())).shape[:2]
    for degree in range(1 if through_origin else 0, max(degree_max.values()) + 1):
        if best and count(seen.points.shape[1], degree) > ENOUGH * samples * equal:
            break
        names = [name for name in targets if degree <= degree_max[name]]
        goal = np.concatenate([targets[name] for name in names], axis=2)
        for ridge, squares in zip(ridges, _squares(seen, goal, weight, fold, degree, through_origin, ridges), strict=True):
            for name, part in zip(names, _apart(squares[judged], targets, names), strict=True):
                form = Form(degree, ridge, float(np.average(part.mean(axis=(1, 2)), weights=weight[judged])))
                best[name] = min(best.get(name, form), form, key=lambda tried: tried.error)
    return best


def _apart(values: np.ndarray, targets: Mapping[str, np.ndarray], names: Sequence[str]) -> list[np.ndarray]:
    """Return ``values`` (S, 1 + k, columns) of the maps ``names``, fitted at once, map by map."""
    return np.split(values, np.cumsum([targets[name].shape[2] for name in names])[:-1], axis=2)


def _squares(
    seen: Seen, goal: np.ndarray, weight: np.ndarray, fold: np.ndarray, degree: int, through_origin: bool,
    ridges: Sequence[float],
) -> np.ndarray:
    """Return the squared errors (ridges, S, 1 + k, columns) of ``goal`` where the fit did not see it, else zero."""
    left = np.empty((len(ridges), *goal.shape))
    left[:] = goal
    for part in np.unique(fold[fold != ALWAYS]):
        inside = fold != part
        normal = equations(seen.rows(inside), goal[inside], weight[inside], degree, through_origin)
        design = seen.rows(~inside).design(degree)
        for k, ridge in enumerate(ridges):
            left[k, ~inside] = design @ normal.solve(ridge).T
    return np.asarray((left - goal) ** 2)


def symmetric_roots(matrices: np.ndarray) -> np.ndarray:
    """Return the symmetric roots (S, r, r) of symmetric ``matrices``, negative parts left out; smooth near identity."""
    values, vectors = np.linalg.eigh(matrices)
    return np.einsum("sik,sk,sjk->sij", vectors, np.sqrt(values.clip(min=0.0)), vectors)
