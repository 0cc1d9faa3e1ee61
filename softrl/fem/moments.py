"""Moments of displacements: sums over the mass of a displacement times products of where a node was.

Among all fields that are polynomials of the place, those are what knows most of a field by the mass. They turn with a body
as it turns, whatever its mesh.
"""

import numpy as np

from softrl.core.polynomial import basis, degree_of

DEGREE = 4  # of the sample robot's moving mass it leaves out one per cent, degree 3 one and a half


def products(points: np.ndarray) -> np.ndarray:
    """Return all products (n, a) of x, y and z up to ``DEGREE``, by degree, at ``points`` (n, 3)."""
    return basis(3, DEGREE).values(points)


def turned(vector: np.ndarray, count: int) -> np.ndarray:
    """Return B (a, a) with ``p(vector x) = B p(x)`` for the first ``count`` products p, full degrees."""
    table = basis(3, degree_of(3, count))
    points = np.random.default_rng(0).standard_normal((4 * count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    here, there = table.values(points), table.values(points @ vector.T)
    mixed = np.zeros((count, count))
    for degree in range(table.degree + 1):  # a turn keeps the degree
        of = table.degrees == degree
        mixed[np.ix_(of, of)] = np.linalg.lstsq(here[:, of], there[:, of], rcond=None)[0].T
    return mixed
