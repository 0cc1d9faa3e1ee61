"""Elastic energy, forces and stiffness of tetrahedra, assembled into node-pair blocks."""

from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np

from softrl.fem.damping import add_rub
from softrl.fem.law import LAW, STRESS, TANGENT, VISCOUS, add_second_derivative_of_volume, cofactor_of

_law = nb.types.FunctionType(LAW)
_f1, _f2, _f3, _f4 = (nb.types.Array(nb.float64, d, "C") for d in (1, 2, 3, 4))
_i2, _i3 = (nb.types.Array(nb.int64, d, "C") for d in (2, 3))


@dataclass(frozen=True)
class NodePairs:
    """The coupled pairs of nodes, each stored once with first <= second.

    Attributes
    ----------
    first, second : (pairs,) node numbers; the block of a pair is d2E / dx_first dx_second
    element_slots : (elements, n, n) block of a local pair, ~block where its transpose is stored
    triangle_slots : (triangles, m, m) likewise
    diagonal : (nodes,) block of each node with itself
    """

    first: np.ndarray
    second: np.ndarray
    element_slots: np.ndarray
    triangle_slots: np.ndarray
    diagonal: np.ndarray


def node_pairs(nodes: int, elements: np.ndarray, triangles: np.ndarray) -> NodePairs:
    """Return the pairs that occur in ``elements`` (E, n) or ``triangles`` (T, m) of ``nodes`` nodes."""
    own = np.arange(nodes, dtype=np.int64)

    def keys(groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = np.broadcast_arrays(groups[:, :, None], groups[:, None, :])
        return np.minimum(a, b) * nodes + np.maximum(a, b), a > b

    element_key, element_swap = keys(elements)
    triangle_key, triangle_swap = keys(triangles)
    unique = np.unique(np.concatenate([element_key.ravel(), triangle_key.ravel(), own * nodes + own]))

    def slots(key: np.ndarray, swap: np.ndarray) -> np.ndarray:
        found = np.searchsorted(unique, key)
        return np.ascontiguousarray(np.where(swap, ~found, found))

    return NodePairs(
        unique // nodes, unique % nodes, slots(element_key, element_swap), slots(triangle_key, triangle_swap),
        np.searchsorted(unique, own * nodes + own),
    )


def _assembler(nodes: int, points: int) -> Any:
    """Return the kernel for elements of so many nodes and integration points: constants make its loops fast."""

    @nb.njit(
        nb.float64(_law, _f1, nb.float64, _f1, _f2, _f2, _i2, _f4, _f2, nb.int64, _i3, _f2, _f3),
        cache=True, fastmath={"contract", "reassoc", "nsz", "arcp"},
    )
    def assemble_elastic(
        law: Any, parameters: np.ndarray, bulk: float, rub: np.ndarray, x: np.ndarray, before: np.ndarray,
        elements: np.ndarray, gradients: np.ndarray, weights: np.ndarray, order: int, slots: np.ndarray,
        gradient: np.ndarray, blocks: np.ndarray,
    ) -> float:
        """Return the elastic energy in J at nodes ``x`` (nodes, 3) m, infinite where the law ends.

        From ``order`` 1 on its gradient is added to ``gradient`` (nodes, 3) N, from 2 on its Hessian to the node-pair
        ``blocks`` (pairs, 3, 3) N/m. ``weights`` (elements, points) m^3 may carry a stiffness factor per element.

        ``bulk`` in Pa adds bulk/2 (J - 1)^2 with J averaged over the element: one condition of volume an element
        does not lock, one at each integration point does. At order ``VISCOUS`` only the rate of that mean is weighed.

        ``rub`` (3,) Pa are moduli lambda, mu and bulk that resist a change from the nodes ``before``, see ``fem.damping``.
        """
        rubs, old, past = rub[1] > 0.0, np.empty((nodes, 3)), np.empty((points, 3, 3))
        cofactor, normal = np.empty((points, 3, 3)), np.empty((nodes, 3))
        volume = push = 0.0
        f, p, tangent = np.empty((3, 3)), np.zeros((3, 3)), np.zeros((9, 9))
        local, part = np.empty((nodes, 3)), np.empty((nodes, 3, 9))
        stiff = np.empty((nodes, 3, 3, nodes))  # node, component, component, node: the last axis vectorises
        column = np.empty((3, nodes))
        energy = 0.0
        for e in range(len(elements)):
            for a in range(nodes):
                for i in range(3):
                    local[a, i] = x[elements[e, a], i]
                    old[a, i] = before[elements[e, a], i]
            if order >= TANGENT:
                stiff[:] = 0.0
            if rubs:
                for q in range(points):
                    past[q] = 0.0
                    for a in range(nodes):
                        for i in range(3):
                            for j in range(3):
                                past[q, i, j] += old[a, i] * gradients[e, q, a, j]
            if bulk > 0.0:
                volume = swept = swept_before = 0.0
                for q in range(points):
                    f[:] = 0.0
                    for a in range(nodes):
                        for i in range(3):
                            for j in range(3):
                                f[i, j] += local[a, i] * gradients[e, q, a, j]
                    volume += weights[e, q]
                    if rubs:
                        swept_before += weights[e, q] * cofactor_of(past[q], cofactor[q])
                    swept += weights[e, q] * cofactor_of(f, cofactor[q])
                push = bulk * (swept / volume - 1.0) if order < VISCOUS else 0.0
                energy += 0.5 * push * (swept - volume)
                if rubs:
                    slow = rub[2] * (swept - swept_before) / volume
                    energy += 0.5 * slow * (swept - swept_before)
                    push += slow
                normal[:] = 0.0
            for q in range(points):
                f[:] = 0.0
                for a in range(nodes):
                    for i in range(3):
                        for j in range(3):
                            f[i, j] += local[a, i] * gradients[e, q, a, j]
                weight = weights[e, q]
                density = law(parameters, f, p, tangent, order)
                if density == np.inf:
                    return np.inf
                energy += weight * density
                if rubs:
                    energy += weight * add_rub(rub[0], rub[1], f, past[q], p, tangent, order)
                if order < STRESS:
                    continue
                if bulk > 0.0:
                    for a in range(nodes):
                        for i in range(3):
                            for j in range(3):
                                normal[a, i] += weight * cofactor[q, i, j] * gradients[e, q, a, j]
                    for i in range(3):
                        for j in range(3):
                            p[i, j] += push * cofactor[q, i, j]
                    if order >= TANGENT:
                        add_second_derivative_of_volume(push, f, tangent)
                for a in range(nodes):
                    for i in range(3):
                        force = 0.0
                        for j in range(3):
                            force += p[i, j] * gradients[e, q, a, j]
                        gradient[elements[e, a], i] += weight * force
                if order < TANGENT:
                    continue
                for a in range(nodes):
                    for j in range(3):
                        column[j, a] = gradients[e, q, a, j]
                    for i in range(3):
                        for n in range(9):
                            part[a, i, n] = 0.0
                        for j in range(3):
                            g = weight * gradients[e, q, a, j]
                            for n in range(9):
                                part[a, i, n] += g * tangent[3 * i + j, n]
                for a in range(nodes):
                    for i in range(3):
                        for k in range(3):
                            t0, t1, t2 = part[a, i, 3 * k], part[a, i, 3 * k + 1], part[a, i, 3 * k + 2]
                            for b in range(nodes):
                                stiff[a, i, k, b] += t0 * column[0, b] + t1 * column[1, b] + t2 * column[2, b]
            if order >= TANGENT:
                if bulk > 0.0:
                    for a in range(nodes):
                        for i in range(3):
                            for k in range(3):
                                for b in range(nodes):
                                    stiff[a, i, k, b] += (bulk + rub[2]) / volume * normal[a, i] * normal[b, k]
                for a in range(nodes):
                    for b in range(nodes):
                        slot = slots[e, a, b]
                        if slot >= 0:
                            for i in range(3):
                                for k in range(3):
                                    blocks[slot, i, k] += stiff[a, i, k, b]
        return energy

    return assemble_elastic


ASSEMBLERS = {4: _assembler(4, 1), 10: _assembler(10, 4)}  # by the number of nodes of an element


@nb.njit(cache=True)
def multiply_blocks(blocks: np.ndarray, first: np.ndarray, second: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return K u (nodes, 3) for the symmetric matrix in node-pair ``blocks``."""
    product = np.zeros_like(u)
    for s in range(len(first)):
        a, b = first[s], second[s]
        for i in range(3):
            for j in range(3):
                product[a, i] += blocks[s, i, j] * u[b, j]
                if a != b:
                    product[b, j] += blocks[s, i, j] * u[a, i]
    return product
