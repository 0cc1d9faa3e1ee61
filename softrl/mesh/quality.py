"""How well shaped the tetrahedra are."""

import numpy as np

from softrl.artifacts.mesh import tetrahedron_volumes
from softrl.core.errors import MeshError
from softrl.mesh.tetrahedra import FACES, Tetrahedra

PAIRS = tuple((i, j) for i in range(4) for j in range(i))


def dihedral_angles(solid: Tetrahedra) -> np.ndarray:
    """Return the six dihedral angles (elements, 6) in degrees; 70.5 in a regular tetrahedron."""
    corner = solid.points[solid.corners]
    normals = [np.cross(corner[:, b] - corner[:, a], corner[:, c] - corner[:, a]) for a, b, c in FACES]
    length = [np.maximum(np.linalg.norm(n, axis=1, keepdims=True), np.finfo(float).tiny) for n in normals]
    unit = [n / s for n, s in zip(normals, length, strict=True)]
    cosine = np.stack([-np.einsum("ed,ed->e", unit[i], unit[j]) for i, j in PAIRS], axis=1)
    return np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))


def smallest_dihedral(solid: Tetrahedra) -> np.ndarray:
    """Return each element's smallest dihedral angle (elements,) in degrees."""
    return dihedral_angles(solid).min(axis=1)


def check_orientation(solid: Tetrahedra, name: str) -> None:
    """Raise ``MeshError`` if an element is inverted or flat."""
    volume = tetrahedron_volumes(solid.points, solid.corners)
    inverted = np.flatnonzero(volume <= 0)
    if len(inverted):
        raise MeshError(
            f"{name} has {len(inverted)} inverted or flat of {len(volume)} tetrahedra, "
            f"the first at {_where(solid, inverted[0])}; expected positive volumes: repair or remesh it"
        )


def check_slivers(solid: Tetrahedra, min_dihedral_deg: float, name: str) -> None:
    """Raise ``MeshError`` if an element has a dihedral angle below ``min_dihedral_deg``."""
    angle = smallest_dihedral(solid)
    slivers = np.flatnonzero(angle < min_dihedral_deg)
    if len(slivers):
        worst = int(angle.argmin())
        raise MeshError(
            f"{name} has {len(slivers)} slivers; the worst has a dihedral angle of {angle[worst]:.2f} deg at "
            f"{_where(solid, worst)}; expected {min_dihedral_deg:g} deg or more: remesh it (give its surface as "
            "stage.source), or lower stage.min_dihedral_deg"
        )


def _where(solid: Tetrahedra, element: int) -> str:
    x, y, z = 1e3 * solid.points[solid.corners[element]].mean(axis=0)
    return f"element {element}, ({x:.1f}, {y:.1f}, {z:.1f}) mm"
