"""Follower pressure: the volume of a cavity is a cubic of its surface nodes, so force and stiffness are exact."""

from itertools import combinations, permutations

import numba as nb
import numpy as np

TRIPLES = np.array(list(combinations(range(6), 3)))


def _sign(order: tuple[int, ...]) -> float:
    return float(np.linalg.det(np.eye(3)[list(order)]))


def _triple_weights() -> np.ndarray:
    """Return w (20,) with V = sum w det(x_a, x_b, x_c) over ``TRIPLES`` for one quadratic triangle.

    The divergence theorem gives V = 1/3 int x . (dx/dr x dx/ds); its integrand is of degree four in (r, s), for
    which a square Gauss rule folded onto the triangle is exact.
    """
    node, weight = np.polynomial.legendre.leggauss(4)
    u, v = np.meshgrid(0.5 * (node + 1.0), 0.5 * (node + 1.0), indexing="ij")
    r, s = u.ravel(), (v * (1.0 - u)).ravel()
    area = (np.outer(weight, weight) * (1.0 - u) / 4.0).ravel()
    share = np.stack([1.0 - r - s, r, s])
    slope = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    shape = [share[i] * (2.0 * share[i] - 1.0) for i in range(3)]
    change = [(4.0 * share[i] - 1.0)[None] * slope[i][:, None] for i in range(3)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        shape.append(4.0 * share[i] * share[j])
        change.append(4.0 * (share[i] * slope[j][:, None] + share[j] * slope[i][:, None]))
    total = np.zeros(len(TRIPLES))
    for t, triple in enumerate(TRIPLES):
        for order in permutations(range(3)):
            a, b, c = (triple[k] for k in order)
            total[t] += _sign(order) * (area * shape[a] * change[b][0] * change[c][1]).sum() / 3.0
    return total


_ALL = _triple_weights()
_USED = np.abs(_ALL) > 1e-14
USED_TRIPLES, WEIGHTS = np.ascontiguousarray(TRIPLES[_USED]), np.ascontiguousarray(_ALL[_USED])
# (triples, weights) of a triangle with so many nodes; a flat one is a sixth of the determinant of its corners
VOLUME_RULE = {3: (np.array([[0, 1, 2]]), np.array([1.0 / 6.0])), 6: (USED_TRIPLES, WEIGHTS)}


@nb.njit(cache=True)
def enclosed_volumes(
    x: np.ndarray, triangles: np.ndarray, cavity: np.ndarray, triples: np.ndarray, weights: np.ndarray, count: int
) -> np.ndarray:
    """Return the volumes (count,) m^3 enclosed by triangles whose normals point inward; the rule is theirs."""
    volume = np.zeros(count)
    for e in range(len(triangles)):
        total = 0.0
        for t in range(len(triples)):
            a, b, c = triangles[e, triples[t, 0]], triangles[e, triples[t, 1]], triangles[e, triples[t, 2]]
            total += weights[t] * (
                x[a, 0] * (x[b, 1] * x[c, 2] - x[b, 2] * x[c, 1])
                + x[a, 1] * (x[b, 2] * x[c, 0] - x[b, 0] * x[c, 2])
                + x[a, 2] * (x[b, 0] * x[c, 1] - x[b, 1] * x[c, 0])
            )
        volume[cavity[e]] -= total
    return volume


@nb.njit(cache=True)
def add_volume_gradient(
    x: np.ndarray, triangles: np.ndarray, cavity: np.ndarray, triples: np.ndarray, weights: np.ndarray,
    pressure: np.ndarray, gradient: np.ndarray,
) -> None:
    """Add sum_i pressure_i dV_i/dx to ``gradient`` (nodes, 3); with pressure in Pa this is the force in N."""
    for e in range(len(triangles)):
        p = pressure[cavity[e]]
        if p == 0.0:
            continue
        for t in range(len(triples)):
            for k in range(3):
                a = triangles[e, triples[t, k]]
                b = triangles[e, triples[t, (k + 1) % 3]]
                c = triangles[e, triples[t, (k + 2) % 3]]
                w = p * weights[t]
                gradient[a, 0] -= w * (x[b, 1] * x[c, 2] - x[b, 2] * x[c, 1])
                gradient[a, 1] -= w * (x[b, 2] * x[c, 0] - x[b, 0] * x[c, 2])
                gradient[a, 2] -= w * (x[b, 0] * x[c, 1] - x[b, 1] * x[c, 0])


@nb.njit(cache=True)
def add_volume_stiffness(
    x: np.ndarray, triangles: np.ndarray, cavity: np.ndarray, triples: np.ndarray, weights: np.ndarray,
    pressure: np.ndarray, slots: np.ndarray, blocks: np.ndarray,
) -> None:
    """Add the Hessian of - sum_i pressure_i V_i to the node-pair ``blocks`` (pairs, 3, 3), N/m.

    ``slots`` (triangles, nodes, nodes) gives the block of a node pair, or ~block where the transpose is what is stored.
    """
    for e in range(len(triangles)):
        p = pressure[cavity[e]]
        if p == 0.0:
            continue
        for t in range(len(triples)):
            for k in range(3):
                w = p * weights[t]
                i, j, m = triples[t, k], triples[t, (k + 1) % 3], triples[t, (k + 2) % 3]
                c = triangles[e, m]
                s = slots[e, i, j]  # d2 det / dx_i dx_j = -[x_m]x, and its transpose for (j, i)
                if s >= 0:
                    block = blocks[s]
                else:
                    block = blocks[~s]
                    w = -w
                block[0, 1] += w * x[c, 2]
                block[0, 2] -= w * x[c, 1]
                block[1, 0] -= w * x[c, 2]
                block[1, 2] += w * x[c, 0]
                block[2, 0] += w * x[c, 1]
                block[2, 1] -= w * x[c, 0]
