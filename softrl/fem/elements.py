"""Tetrahedra with straight edges, quadratic or linear: nodes, shape gradients, integration weights."""

from dataclasses import dataclass

import numpy as np

from softrl.artifacts.mesh import BASE, FREE, PLATE, Mesh, tetrahedron_volumes
from softrl.core.errors import ConfigError, MeshError

EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])  # node 4 + k lies on edge k
FACE_EDGES = np.array([[0, 1], [1, 2], [2, 0]])  # node 3 + k of a surface triangle lies on edge k
_INNER, _OUTER = (5.0 - np.sqrt(5.0)) / 20.0, (5.0 + 3.0 * np.sqrt(5.0)) / 20.0
GAUSS = np.where(np.eye(4, dtype=bool), _OUTER, _INNER)  # (4 points, 4) barycentric; exact for quadratics
# share of an element's mass that each of its nodes carries; the quadratic ones by HRZ lumping
MASS_SHARE = {4: np.full(4, 1.0 / 4.0), 10: np.r_[np.full(4, 1.0 / 36.0), np.full(6, 4.0 / 27.0)]}


@dataclass(frozen=True)
class Solid:
    """The elements of a body: 10-node tetrahedra and 6-node cavity triangles, or linear ones of 4 and 3 nodes.

    Attributes
    ----------
    points : (nodes, 3) m; the mesh's own corner nodes come first
    corners : number of corner nodes
    edge_ends : (nodes - corners, 2) the corner nodes on whose edge each mid-edge node lies
    elements : (elements, 10 or 4)
    region : (nodes,) as in ``Mesh.node_region``; a mid-edge node belongs where both ends of its edge do
    cavity_triangles : (triangles, 6 or 3) three corners, then the nodes on edges 01, 12, 20
    cavity_of_triangle : (triangles,) chamber number
    gradients : (elements, 4 or 1, 10 or 4, 3) 1/m, shape gradients at the Gauss points
    weights : (elements, 4 or 1) m^3
    """

    points: np.ndarray
    corners: int
    edge_ends: np.ndarray
    elements: np.ndarray
    region: np.ndarray
    cavity_triangles: np.ndarray
    cavity_of_triangle: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray

    def volumes(self) -> np.ndarray:
        """Return the volume of each element (elements,) in m^3."""
        return self.weights.sum(axis=1)

    def lumped_mass(self, density: float) -> np.ndarray:
        """Return nodal masses (nodes,) in kg, all positive."""
        share = MASS_SHARE[self.elements.shape[1]]
        mass = np.zeros(len(self.points))
        np.add.at(mass, self.elements, density * self.volumes()[:, None] * share)
        return mass

    def plate_centroid(self) -> np.ndarray:
        """Return the tip (3,) m: volume centroid of the elements that lie wholly in the plate.

        A plate without such an element (a face only) gives the mean of its corner nodes.
        """
        inside = (self.region[self.elements[:, :4]] == PLATE).all(axis=1)
        if not inside.any():
            plate = np.flatnonzero(self.region[: self.corners] == PLATE)
            return self.points[plate].mean(axis=0)
        centre = self.points[self.elements[inside, :4]].mean(axis=1)
        return np.average(centre, axis=0, weights=self.volumes()[inside])


def solid_of(mesh: Mesh, order: int) -> Solid:
    """Return the elements of ``order`` 1 or 2 on ``mesh``."""
    orders = {1: linear_mesh, 2: quadratic_mesh}
    if order not in orders:
        raise ConfigError(f"element_order={order} is unknown; expected 2 (quadratic tetrahedra) or 1 (linear, they lock)")
    return orders[order](mesh)


def linear_mesh(mesh: Mesh) -> Solid:
    """Return ``mesh`` as it is; cavity triangles may lie on any of its nodes."""
    tetrahedra = mesh.tetrahedra.astype(np.int64)
    gradients = _barycentric_gradients(mesh.points, tetrahedra)[:, None]
    weights = tetrahedron_volumes(mesh.points, tetrahedra)[:, None]
    return Solid(
        np.array(mesh.points, dtype=float), len(mesh.points), np.zeros((0, 2), dtype=np.int64), tetrahedra,
        np.asarray(mesh.node_region), mesh.cavity_triangles.astype(np.int64), mesh.cavity_of_triangle.astype(np.int64),
        np.ascontiguousarray(gradients), weights,
    )


def quadratic_mesh(mesh: Mesh) -> Solid:
    """Return ``mesh`` with a node added at the middle of every edge."""
    tetrahedra = mesh.tetrahedra.astype(np.int64)
    corners = len(mesh.points)
    ends = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    key, inverse = np.unique(ends[:, 0] * corners + ends[:, 1], return_inverse=True)
    edge = np.stack([key // corners, key % corners], axis=1)
    elements = np.hstack([tetrahedra, corners + inverse.reshape(-1, 6)])
    points = np.vstack([mesh.points, mesh.points[edge].mean(axis=1)])
    same = mesh.node_region[edge[:, 0]] == mesh.node_region[edge[:, 1]]
    region = np.r_[mesh.node_region, np.where(same, mesh.node_region[edge[:, 0]], FREE)]

    triangles = mesh.cavity_triangles.astype(np.int64)
    sides = np.sort(triangles[:, FACE_EDGES].reshape(-1, 2), axis=1)
    side_key = sides[:, 0] * corners + sides[:, 1]
    stray = int((~np.isin(side_key, key)).sum())
    if stray:
        raise MeshError(
            f"mesh of {mesh.robot_name}: {stray} edges of cavity triangles are no edges of tetrahedra; "
            "the cavities must be faces of the mesh, take them from its boundary"
        )
    middle = corners + np.searchsorted(key, side_key)
    gradients, weights = shape_gradients(mesh.points, tetrahedra)
    return Solid(
        points, corners, edge, elements, region, np.hstack([triangles, middle.reshape(-1, 3)]),
        mesh.cavity_of_triangle.astype(np.int64), gradients, weights,
    )


def shape_gradients(points: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return gradients (elements, 4, 10, 3) in 1/m and weights (elements, 4) in m^3 at the Gauss points."""
    barycentric = _barycentric_gradients(points, tetrahedra)
    gradients = np.empty((len(tetrahedra), 4, 10, 3))
    for q, share in enumerate(GAUSS):
        gradients[:, q, :4] = (4.0 * share[:, None] - 1.0) * barycentric
        for k, (i, j) in enumerate(EDGES):
            gradients[:, q, 4 + k] = 4.0 * (share[i] * barycentric[:, j] + share[j] * barycentric[:, i])
    volume = tetrahedron_volumes(points, tetrahedra)
    return gradients, np.repeat(volume[:, None] / 4.0, 4, axis=1)


def barycentric(corner: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the barycentric coordinates (n, 4) of ``points`` (n, 3) in tetrahedra of ``corner`` (n, 4, 3)."""
    sides = np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2)
    inner = np.linalg.solve(sides, (points - corner[:, 0])[..., None])[..., 0]
    return np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)


def shape_at(share: np.ndarray, nodes: int) -> np.ndarray:
    """Return the shape functions (points, nodes) of elements of 4 or 10 nodes at barycentric points (points, 4)."""
    if nodes == 4:
        return share
    return np.concatenate([share * (2.0 * share - 1.0), 4.0 * share[:, EDGES[:, 0]] * share[:, EDGES[:, 1]]], axis=1)


def _barycentric_gradients(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the gradients (elements, 4, 3) in 1/m of the barycentric coordinates."""
    corner = points[tetrahedra]
    inverse = np.linalg.inv(np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2))
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


def rigid_bodies(region: np.ndarray) -> list[int]:
    """Return the region numbers of the rigid bodies: plate first, then the ribs from below."""
    return [int(r) for r in np.unique(region) if r not in (FREE, BASE)]
