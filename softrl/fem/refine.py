"""Finer meshes of the same solid: every tetrahedron is cut into equal parts, and a shape is carried over to them.

Solid, regions and cavities stay exactly as they are, and so do the shapes of the elements, so that answers on finer
and finer meshes differ by the discretisation alone. Meshes made anew would also differ in shape, and fTetWild makes each
of them by chance.
"""

from itertools import product

import numpy as np

from softrl.artifacts.mesh import FREE, Mesh, tetrahedron_volumes
from softrl.core.errors import ConfigError
from softrl.fem.coupling import Pose
from softrl.fem.elements import Solid, barycentric, shape_at
from softrl.fem.model import FemModel


def refine(mesh: Mesh, parts: int) -> Mesh:
    """Return ``mesh`` with every edge cut into ``parts`` and every tetrahedron into ``parts`` cubed.

    A new node is in a region if all corners of the edge, face or tetrahedron that it lies in are.
    """
    if parts < 1:
        raise ConfigError(f"parts={parts} must be at least 1")
    if parts == 1:
        return mesh
    solid, tetrahedra = _lattice(4, parts), _tetrahedra_of(parts)
    face, triangles = _lattice(3, parts), _triangles_of(parts)
    key = np.concatenate([
        _keys(mesh.tetrahedra, solid).reshape(-1, 8), _keys(mesh.cavity_triangles, face).reshape(-1, 8),
    ])
    unique, number = np.unique(key, axis=0, return_inverse=True)
    number = number.ravel()
    inside = number[: len(mesh.tetrahedra) * len(solid)].reshape(-1, len(solid))
    surface = number[len(mesh.tetrahedra) * len(solid) :].reshape(-1, len(face))
    corner, weight = unique[:, :4], unique[:, 4:]
    points = np.einsum("nc,nci->ni", weight / parts, mesh.points[corner])
    region = mesh.node_region[corner]
    alike = ((region == region[:, :1]) | (weight == 0)).all(axis=1)
    diagonal = _shortest_diagonal(points, inside, solid)
    cut = np.where(
        diagonal[:, None, None] == 0, inside[:, tetrahedra[0]],
        np.where(diagonal[:, None, None] == 1, inside[:, tetrahedra[1]], inside[:, tetrahedra[2]]),
    ).reshape(-1, 4)
    flipped = tetrahedron_volumes(points, cut) < 0
    cut[flipped] = cut[flipped][:, [1, 0, 2, 3]]
    return Mesh(
        points, cut, np.where(alike, region[:, 0], FREE), np.repeat(mesh.element_layer, parts**3),
        surface[:, triangles].reshape(-1, 3), np.repeat(mesh.cavity_of_triangle, parts**2), mesh.robot_name,
    )


def carried(coarse: FemModel, pose: Pose, fine: FemModel, root: Mesh) -> Pose:
    """Return the pose of ``fine`` in the shape that ``coarse`` has in ``pose``; ``refine`` cut both out of ``root``."""
    position = _interpolated(coarse.solid, pose.position, fine.solid, len(root.tetrahedra))
    centre = pose.centre + np.einsum("kij,kj->ki", pose.rotation, fine.coupling.centres - coarse.coupling.centres)
    for k, (member, arm) in enumerate(zip(fine.coupling.members, fine.coupling.arms, strict=True)):
        position[member] = centre[k] + arm @ pose.rotation[k].T
    return Pose(position, centre, pose.rotation.copy())


def _interpolated(coarse: Solid, position: np.ndarray, fine: Solid, roots: int) -> np.ndarray:
    """Return where ``coarse``, its nodes at ``position``, has the nodes of ``fine``, (nodes, 3) m.

    Parts stand in the order of the ``roots`` tetrahedra that they were cut out of, so that a node is looked for in few.
    """
    mine, parts = len(fine.elements) // roots, len(coarse.elements) // roots
    root = np.empty(len(fine.points), dtype=int)
    root[fine.elements] = (np.arange(len(fine.elements)) // mine)[:, None]
    inside, found = np.full(len(root), -np.inf), np.empty_like(fine.points)
    for part in range(parts):
        nodes = coarse.elements[root * parts + part]
        share = barycentric(coarse.points[nodes[:, :4]], fine.points)
        better = share.min(axis=1) > inside
        inside[better] = share[better].min(axis=1)
        shape = shape_at(share[better], nodes.shape[1])
        found[better] = np.einsum("na,nai->ni", shape, position[nodes[better]])
    return found


def _lattice(corners: int, parts: int) -> np.ndarray:
    """Return the integer barycentric points (points, corners), of sum ``parts``, in lexicographic order."""
    return np.array([w for w in product(range(parts + 1), repeat=corners) if sum(w) == parts])


def _keys(cells: np.ndarray, lattice: np.ndarray) -> np.ndarray:
    """Return (cells, points, 8): node numbers and weights by rising node, the same for a point shared by cells."""
    shape = (len(cells), *lattice.shape)
    weight = np.broadcast_to(lattice, shape)
    anchor = cells[:, None, :]
    # a corner without weight is replaced by one that has some, so that it does not tell two cells apart
    heaviest = np.take_along_axis(np.broadcast_to(anchor, shape), weight.argmax(axis=2)[..., None], axis=2)
    node = np.where(weight > 0, anchor, np.iinfo(np.int64).max)
    order = np.argsort(node, axis=2, kind="stable")
    node, weight = np.take_along_axis(node, order, axis=2), np.take_along_axis(weight, order, axis=2)
    node = np.where(weight > 0, node, np.minimum(node[..., :1], heaviest))
    missing = 4 - shape[2]
    if missing:
        node = np.concatenate([node, np.repeat(node[..., :1], missing, axis=2)], axis=2)
        weight = np.concatenate([weight, np.zeros((*shape[:2], missing), weight.dtype)], axis=2)
    return np.concatenate([node, weight], axis=2)


def _tetrahedra_of(parts: int) -> np.ndarray:
    """Return (3 diagonals, parts^3, 4) lattice points of the small tetrahedra, for each diagonal of the octahedra."""
    at = {tuple(w): n for n, w in enumerate(_lattice(4, parts))}
    unit = np.eye(4, dtype=int)

    def point(base: tuple[int, ...], *steps: int) -> int:
        return at[tuple(np.add(base, sum(unit[s] for s in steps)))]

    upright = [[point(b, c) for c in range(4)] for b in map(tuple, _lattice(4, parts - 1))]
    turned = [
        [point(b, *[c for c in range(4) if c != left]) for left in range(4)]
        for b in (map(tuple, _lattice(4, parts - 3)) if parts >= 3 else ())
    ]
    choices = []
    for across in ((0, 1), (0, 2), (0, 3)):
        other = tuple(c for c in range(4) if c not in across)
        pieces = []
        for b in map(tuple, _lattice(4, parts - 2)):
            ends = point(b, *across), point(b, *other)
            ring = [point(b, across[i], other[j]) for i, j in ((0, 0), (0, 1), (1, 1), (1, 0))]
            pieces += [[*ends, ring[k], ring[(k + 1) % 4]] for k in range(4)]
        choices.append(upright + turned + pieces)
    return np.array(choices)


def _triangles_of(parts: int) -> np.ndarray:
    """Return (parts^2, 3) lattice points of the small triangles, turned as the large one."""
    at = {tuple(w): n for n, w in enumerate(_lattice(3, parts))}
    unit = np.eye(3, dtype=int)
    upright = [[at[tuple(b + unit[c])] for c in range(3)] for b in _lattice(3, parts - 1)]
    turned = [[at[tuple(b + 1 - unit[c])] for c in range(3)] for b in _lattice(3, parts - 2)]
    return np.array(upright + turned)


def _shortest_diagonal(points: np.ndarray, inside: np.ndarray, lattice: np.ndarray) -> np.ndarray:
    """Return for each large tetrahedron which of its octahedra's three diagonals is the shortest (0, 1, 2)."""
    parts = int(lattice[0].sum())
    ends = inside[:, [int(np.flatnonzero((lattice == parts * np.eye(4, dtype=int)[c]).all(axis=1))[0]) for c in range(4)]]
    x = points[ends]
    lengths = [
        np.linalg.norm(x[:, 0] + x[:, k] - sum(x[:, c] for c in (1, 2, 3) if c != k), axis=1) for k in (1, 2, 3)
    ]
    return np.argmin(lengths, axis=0)
