"""Closed triangle surfaces: their shells, which of them are cavities, and what is wrong with them."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from softrl.core.errors import MeshError


@dataclass(frozen=True)
class Surface:
    """Triangles whose normals point out of the solid.

    Attributes
    ----------
    points : (nodes, 3) m
    triangles : (triangles, 3) node numbers
    """

    points: np.ndarray
    triangles: np.ndarray

    def volume(self) -> float:
        """Return the enclosed volume in m^3; negative when the normals point inward."""
        return enclosed_volume(self.points, self.triangles)

    def wall(self) -> float:
        """Return the mean thickness in m of what it bounds: twice its volume over its area, as of a thin plate."""
        a, b, c = self.points[self.triangles].transpose(1, 0, 2)
        return 2.0 * self.volume() / float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def enclosed_volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the signed volume in m^3 inside closed ``triangles`` (triangles, 3) over ``points`` (nodes, 3) m."""
    # measured from the surface's own middle, so that distance from the origin costs no digits
    corner = points[triangles] - points[triangles].mean(axis=(0, 1))
    return float(np.einsum("ti,ti->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0)


def centroid(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the centroid (3,) m of the volume inside closed ``triangles``, wherever its surface is finer."""
    middle = points[triangles].mean(axis=(0, 1))
    corner = points[triangles] - middle
    share = np.einsum("ti,ti->t", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
    return np.asarray(middle + share @ corner.sum(axis=1) / (4.0 * share.sum()))


def merge_points(points: np.ndarray, triangles: np.ndarray, tolerance: float) -> Surface:
    """Return the surface with points closer than about ``tolerance`` (m) made one (STL repeats every corner)."""
    _, first, number = np.unique(np.round(points / tolerance), axis=0, return_index=True, return_inverse=True)
    merged = number.reshape(-1)[triangles]
    distinct = (merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])
    return Surface(points[first], merged[distinct])


def check_closed(triangles: np.ndarray, points: np.ndarray, name: str) -> None:
    """Raise ``MeshError`` unless the triangles at every edge close the surface and agree on their normals.

    Four triangles at an edge are no hole: there the surface touches itself.
    """
    directed = directed_edges(triangles)
    edge, which, uses = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    sense = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    balance = np.bincount(which.reshape(-1), weights=sense)
    for wrong, what, remedy in (
        (uses % 2 == 1, "is open: {} edges lack a triangle", "close its holes, or export it again"),
        (balance != 0, "has {} edges whose triangles disagree on their normals", "unify the normals"),
    ):
        if wrong.any():
            x, y, z = 1e3 * points[edge[wrong][0]].mean(axis=0)
            many = what.format(int(wrong.sum()))
            raise MeshError(f"{name} {many}, the first at ({x:.1f}, {y:.1f}, {z:.1f}) mm; {remedy}")


def directed_edges(triangles: np.ndarray) -> np.ndarray:
    """Return the edges (3 triangles, 2) of ``triangles`` in their sense of rotation."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def label_shells(triangles: np.ndarray) -> np.ndarray:
    """Return the number (triangles,) of the connected shell that each triangle belongs to.

    Triangles are connected through edges that only two of them share, so that shells stay apart that touch in a
    node or along an edge.
    """
    count = len(triangles)
    _, which, uses = np.unique(
        np.sort(directed_edges(triangles), axis=1), axis=0, return_inverse=True, return_counts=True
    )
    which = which.reshape(-1)
    plain = np.flatnonzero(uses[which] == 2)
    left, right = (np.tile(np.arange(count), 3)[plain][np.argsort(which[plain])]).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(left)), (left, right)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def winding_number(query: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return how often a closed surface winds around each of ``query`` (queries, 3) m: 1 inside, 0 outside.

    Notes
    -----
    Sum of the solid angles of the triangles over 4 pi (Van Oosterom and Strackee 1983; no number checked).
    """
    total = np.empty(len(query))
    corner = points[triangles]
    for i, q in enumerate(query):
        a, b, c = np.moveaxis(corner - q, 1, 0)
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        determinant = np.einsum("ti,ti->t", a, np.cross(b, c))
        denominator = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        total[i] = np.arctan2(determinant, denominator).sum() / (2.0 * np.pi)
    return total


def orient_shells(surface: Surface) -> Surface:
    """Return the surface with solid shells turned outward and cavity shells inward, whatever they were in the file.

    A shell inside an odd number of other shells bounds a cavity.
    """
    shell = label_shells(surface.triangles)
    triangles = surface.triangles.copy()
    parts = [triangles[shell == k] for k in range(shell.max() + 1)]
    for k, part in enumerate(parts):
        start = surface.points[part[0, :1]]
        depth = sum(
            round(abs(winding_number(start, surface.points, other)[0])) for j, other in enumerate(parts) if j != k
        )
        wants = -1.0 if depth % 2 else 1.0
        if enclosed_volume(surface.points, part) * wants < 0:
            triangles[shell == k] = part[:, ::-1]
    return Surface(surface.points, triangles)
