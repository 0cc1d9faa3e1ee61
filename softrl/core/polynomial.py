"""Polynomials of several variables as dense tables: monomials by degree, and derivatives as further polynomials.

Monomials are numbered by degree, so those of degree up to ``d`` are the first ``count(variables, d)`` of any table:
maps of different degree share one evaluation.
"""

import itertools
from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np


def count(variables: int, degree: int) -> int:
    """Return the number of monomials of degree 0 to ``degree``."""
    return comb(variables + degree, variables)


def degree_of(variables: int, monomials: int) -> int:
    """Return the degree whose monomials number ``monomials``."""
    degree = 0
    while count(variables, degree) < monomials:
        degree += 1
    if count(variables, degree) != monomials:
        raise ValueError(f"{monomials} monomials of {variables} variables fill no degree")
    return degree


def pairs(variables: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the upper triangle, the order in which Hessians are stored."""
    return np.triu_indices(variables)


@dataclass(frozen=True)
class Basis:
    """All monomials of ``variables`` variables up to ``degree``, numbered by degree.

    Attributes
    ----------
    parent, variable : (monomials,) monomial k is monomial ``parent[k]`` times variable ``variable[k]``
    degrees : (monomials,) total degree
    raised, factor : (variables, monomials of lower degree) the derivative by variable j of monomial ``raised[j, k]`` is
        ``factor[j, k]`` times monomial k
    """

    variables: int
    degree: int
    parent: np.ndarray
    variable: np.ndarray
    degrees: np.ndarray
    raised: np.ndarray
    factor: np.ndarray

    @property
    def monomials(self) -> int:
        """Number of monomials."""
        return len(self.parent)

    def values(self, points: np.ndarray) -> np.ndarray:
        """Return the monomials (points, monomials) at ``points`` (points, variables)."""
        table = np.ones((len(points), self.monomials))
        for k in range(1, self.monomials):
            table[:, k] = table[:, self.parent[k]] * points[:, self.variable[k]]
        return table

    def derivative(self, coefficients: np.ndarray) -> np.ndarray:
        """Return (variables, ..., monomials one degree lower) of the gradient of polynomials (..., monomials)."""
        return np.stack(
            [coefficients[..., raised] * factor for raised, factor in zip(self.raised, self.factor, strict=True)]
        )

    def hessian(self, coefficients: np.ndarray) -> np.ndarray:
        """Return (pairs, monomials two degrees lower) of the Hessian of one polynomial (monomials,)."""
        lower = basis(self.variables, max(self.degree - 1, 0))
        second = lower.derivative(self.derivative(coefficients))
        rows, columns = pairs(self.variables)
        return second[columns, rows]

    def gradient_rows(self, points: np.ndarray) -> np.ndarray:
        """Return (points, variables, monomials): the gradient of every monomial at ``points``."""
        values = self.values(points)[:, : self.raised.shape[1]]
        rows = np.zeros((len(points), self.variables, self.monomials))
        for j in range(self.variables):
            rows[:, j, self.raised[j]] = values * self.factor[j]
        return rows

    def hessian_rows(self, points: np.ndarray) -> np.ndarray:
        """Return (points, variables, variables, monomials): the Hessian of every monomial at ``points``."""
        lower = basis(self.variables, self.degree - 1)
        inner = lower.gradient_rows(points)
        rows = np.zeros((len(points), self.variables, self.variables, self.monomials))
        for j in range(self.variables):
            rows[:, :, j, self.raised[j]] = inner * self.factor[j]
        return rows

    def third_rows(self, points: np.ndarray) -> np.ndarray:
        """Return (points, variables, variables, variables, monomials): the third derivatives of every monomial."""
        inner = basis(self.variables, self.degree - 1).hessian_rows(points)
        rows = np.zeros((*inner.shape[:3], self.variables, self.monomials))
        for j in range(self.variables):
            rows[:, :, :, j, self.raised[j]] = inner * self.factor[j]
        return rows


@lru_cache(maxsize=64)
def basis(variables: int, degree: int) -> Basis:
    """Return the basis of ``variables`` variables up to ``degree``."""
    words = [w for d in range(degree + 1) for w in itertools.combinations_with_replacement(range(variables), d)]
    number = {word: k for k, word in enumerate(words)}
    below = words[: count(variables, degree - 1)] if degree else []
    raised = np.array([[number[tuple(sorted((*w, j)))] for w in below] for j in range(variables)], dtype=np.int64)
    factor = np.array([[w.count(j) + 1.0 for w in below] for j in range(variables)])
    return Basis(
        variables,
        degree,
        np.array([number[w[:-1]] if w else 0 for w in words], dtype=np.int64),
        np.array([w[-1] if w else 0 for w in words], dtype=np.int64),
        np.array([len(w) for w in words], dtype=np.int64),
        raised.reshape(variables, -1),
        factor.reshape(variables, -1),
    )


@lru_cache(maxsize=64)
def multinomials(variables: int, degree: int) -> np.ndarray:
    """Return the multinomial number (monomials,) of each monomial: how often it occurs in a power of the sum of all."""
    table = basis(variables, degree)
    numbers, powers = np.ones(table.monomials), np.zeros((table.monomials, variables))
    for k in range(1, table.monomials):
        parent, variable = table.parent[k], table.variable[k]
        powers[k] = powers[parent]
        powers[k, variable] += 1.0
        numbers[k] = numbers[parent] * table.degrees[k] / powers[k, variable]
    return numbers


@lru_cache(maxsize=16)
def _products(variables: int, degree: int) -> np.ndarray:
    """Return the number (monomials, monomials), among those up to twice ``degree``, of each product of two monomials."""
    words = [w for d in range(2 * degree + 1) for w in itertools.combinations_with_replacement(range(variables), d)]
    number, few = {word: k for k, word in enumerate(words)}, words[: count(variables, degree)]
    return np.array([[number[tuple(sorted((*a, *b)))] for b in few] for a in few])


def sum_of_squares(variables: int, coefficients: np.ndarray) -> np.ndarray:
    """Return the sum (monomials of twice the degree,) of the squares of polynomials ``coefficients`` (rows, monomials)."""
    degree = degree_of(variables, coefficients.shape[1])
    total = np.zeros(count(variables, 2 * degree))
    np.add.at(total, _products(variables, degree), coefficients.T @ coefficients)
    return total
