"""Moments of displacements: sums over the mass of a displacement times products of where a node was.

Among all fields that are polynomials of the place, those are what knows most of a field by the mass. They turn with a body
as it turns, whatever its mesh.
"""

from itertools import product

import numpy as np

DEGREE = 4  # of the sample robot's moving mass it leaves out one per cent, degree 3 one and a half


def powers(degree: int = DEGREE) -> np.ndarray:
    """Return the exponents (a, 3) of all products of x, y and z up to ``degree``, the constant first."""
    every = [each for each in product(range(degree + 1), repeat=3) if sum(each) <= degree]
    return np.array(sorted(every, key=lambda each: (sum(each), each)))


def products(points: np.ndarray, exponents: np.ndarray) -> np.ndarray:
    """Return the products (n, a) of ``exponents`` (a, 3) at ``points`` (n, 3)."""
    return np.asarray(np.prod(points[:, None] ** exponents, axis=2))


def turned(vector: np.ndarray, count: int) -> np.ndarray:
    """Return B (a, a) with ``p(vector x) = B p(x)`` for the first ``count`` products p, full degrees."""
    degree = 0
    while len(powers(degree)) < count:
        degree += 1
    exponents = powers(degree)
    points = np.random.default_rng(0).standard_normal((4 * count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    mixed = np.zeros((count, count))
    total = exponents.sum(axis=1)
    for each in range(degree + 1):  # a turn keeps the degree
        of = total == each
        here, there = products(points, exponents[of]), products(points @ vector.T, exponents[of])
        mixed[np.ix_(of, of)] = np.linalg.lstsq(here, there, rcond=None)[0].T
    return mixed
