"""Finer meshes of the same body: the longest edges are halved until there are as many unknowns as wanted."""

from dataclasses import replace

import numpy as np

from softrl.artifacts.mesh import FREE, Mesh
from softrl.core.errors import ConfigError

EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
SHARE = 0.25  # of the edges that one sweep may halve: short ones wait, so that elements keep their shape


def refined(mesh: Mesh, unknowns: int) -> Mesh:
    """Return ``mesh`` with edges halved until its quadratic elements have about ``unknowns`` unknowns, or as it is.

    Notes
    -----
    Halving an edge halves all elements at it, so the mesh stays conforming; in one sweep an element is halved once.
    The surface keeps its shape: a new node lies on the straight edge.
    """
    while (have := quadratic_unknowns(mesh)) < 0.99 * unknowns:
        finer = _sweep(mesh, (unknowns - have) / have)
        if len(finer.points) == len(mesh.points):
            raise ConfigError(f"the mesh of {mesh.robot_name} cannot be refined to {unknowns} unknowns")
        mesh = finer
    return mesh


def quadratic_unknowns(mesh: Mesh) -> int:
    """Return how many unknowns the free nodes, corners and middles of edges, have."""
    edges = _edges(mesh.tetrahedra)
    fixed = (mesh.node_region[edges[:, 0]] == mesh.node_region[edges[:, 1]]) & (mesh.node_region[edges[:, 0]] != FREE)
    return 3 * int((mesh.node_region == FREE).sum() + (~fixed).sum())


def _edges(tetrahedra: np.ndarray) -> np.ndarray:
    pairs = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0)


def _sweep(mesh: Mesh, wanted_growth: float) -> Mesh:
    """Return ``mesh`` after halving long edges, at most one in each element; growth is in shares of the unknowns."""
    pairs = np.sort(mesh.tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    edges, number = np.unique(pairs, axis=0, return_inverse=True)
    number = number.reshape(-1, 6)
    length = np.linalg.norm(mesh.points[edges[:, 0]] - mesh.points[edges[:, 1]], axis=1)
    around: list[list[int]] = [[] for _ in edges]
    for element, own in enumerate(number):
        for edge in own:
            around[edge].append(element)
    halved, elements = [], np.full(len(mesh.tetrahedra), -1)
    limit = max(1, int(min(SHARE * len(edges), 0.6 * wanted_growth * len(mesh.points))))
    for edge in np.argsort(-length)[: int(SHARE * len(edges)) + 1]:
        if len(halved) == limit:
            break
        if (elements[around[edge]] < 0).all():
            elements[around[edge]] = edge
            halved.append(edge)
    return _halve(mesh, edges, np.array(halved), elements)


def _halve(mesh: Mesh, edges: np.ndarray, halved: np.ndarray, edge_of_element: np.ndarray) -> Mesh:
    """Return ``mesh`` with a node in the middle of the edges ``halved``; ``edge_of_element`` is -1 for none."""
    middle = np.full(len(edges), -1)
    middle[halved] = len(mesh.points) + np.arange(len(halved))
    ends = edges[halved]
    points = np.vstack([mesh.points, mesh.points[ends].mean(axis=1)])
    same = mesh.node_region[ends[:, 0]] == mesh.node_region[ends[:, 1]]
    region = np.r_[mesh.node_region, np.where(same, mesh.node_region[ends[:, 0]], FREE)]
    cut = np.flatnonzero(edge_of_element >= 0)
    edge = edge_of_element[cut]
    tetrahedra = _split(mesh.tetrahedra, cut, edges[edge], middle[edge])
    layer = np.r_[mesh.element_layer, mesh.element_layer[cut]]

    key = {(int(a), int(b)): int(m) for (a, b), m in zip(ends, middle[halved], strict=True)}
    triangles, chamber = mesh.cavity_triangles, mesh.cavity_of_triangle
    while (hit := _halved_sides(triangles, key)).size:  # a triangle may have more than one halved side
        cut_ends = np.array([_halved_side(triangles[t], key) for t in hit])
        new = np.array([key[(int(a), int(b))] for a, b in cut_ends])
        triangles, chamber = _split(triangles, hit, cut_ends, new), np.r_[chamber, chamber[hit]]
    return replace(
        mesh, points=points, tetrahedra=tetrahedra, node_region=region, element_layer=layer,
        cavity_triangles=triangles, cavity_of_triangle=chamber,
    )  # fmt: skip


def _split(cells: np.ndarray, cut: np.ndarray, ends: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return ``cells`` with the rows ``cut`` halved at ``middle`` between ``ends``: in place, and at the end."""
    first, second = cells.copy(), cells[cut].copy()
    row = first[cut]
    row[row == ends[:, :1]] = np.broadcast_to(middle[:, None], row.shape)[row == ends[:, :1]]
    first[cut] = row
    second[second == ends[:, 1:]] = np.broadcast_to(middle[:, None], second.shape)[second == ends[:, 1:]]
    return np.vstack([first, second])


def _halved_side(triangle: np.ndarray, key: dict[tuple[int, int], int]) -> tuple[int, int] | None:
    for i in range(3):
        a, b = sorted((int(triangle[i]), int(triangle[(i + 1) % 3])))
        if (a, b) in key:
            return a, b
    return None


def _halved_sides(triangles: np.ndarray, key: dict[tuple[int, int], int]) -> np.ndarray:
    return np.array([t for t, triangle in enumerate(triangles) if _halved_side(triangle, key)], dtype=int)
