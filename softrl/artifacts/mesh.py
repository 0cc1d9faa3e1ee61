"""The volume mesh of a robot, with the names of its parts."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError

FREE, BASE, PLATE, FIRST_RIB = 0, 1, 2, 11


@dataclass(frozen=True)
class Mesh(Artifact):
    """Linear tetrahedra of the solid (not of its cavities) in the base frame, z along the robot.

    Attributes
    ----------
    points : (nodes, 3) m
    tetrahedra : (elements, 4) node numbers, positive volume
    node_region : (nodes,) 0 free, 1 fixed base, 2 rigid top plate, 11, 12, .. rigid ribs from below
    element_layer : (elements,) 0 below the first rib, then counted upward
    cavity_triangles : (triangles, 3) node numbers; normals point into the cavity (out of the solid)
    cavity_of_triangle : (triangles,) chamber number from 0, order as in ``Robot``
    robot_name : the robot this is a mesh of
    """

    stage: ClassVar[str] = "mesh"

    points: np.ndarray
    tetrahedra: np.ndarray
    node_region: np.ndarray
    element_layer: np.ndarray
    cavity_triangles: np.ndarray
    cavity_of_triangle: np.ndarray
    robot_name: str

    @property
    def chambers(self) -> int:
        """Number of cavities."""
        return int(self.cavity_of_triangle.max()) + 1

    @property
    def layers(self) -> int:
        """Number of layers, one more than ribs."""
        return int(self.element_layer.max()) + 1

    def volume(self) -> float:
        """Return the volume of the solid in m^3."""
        return float(tetrahedron_volumes(self.points, self.tetrahedra).sum())

    def cavity_volume(self, chamber: int) -> float:
        """Return the enclosed volume of one cavity in m^3, positive when its normals point into it."""
        corners = self.points[self.cavity_triangles[self.cavity_of_triangle == chamber]]
        return -float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)

    def validate(self) -> None:
        """Check lengths, index ranges, element orientation and that every chamber has a closed cavity."""
        super().validate()
        self._check_numbers()
        inverted = int((tetrahedron_volumes(self.points, self.tetrahedra) <= 0).sum())
        if inverted:
            raise ArtifactError(f"mesh of {self.robot_name} has {inverted} inverted or flat tetrahedra; remesh it")
        for chamber in range(self.chambers):
            if not _is_closed(self.cavity_triangles[self.cavity_of_triangle == chamber]):
                raise ArtifactError(
                    f"cavity {chamber + 1} of {self.robot_name} is open, or its triangles disagree on their normals; expected a "
                    "closed surface: only such a one encloses a volume"
                )
            if self.cavity_volume(chamber) <= 0:
                raise ArtifactError(f"cavity {chamber + 1} of {self.robot_name} encloses no positive volume")

    def _check_numbers(self) -> None:
        """Raise ``ArtifactError`` unless lengths agree, and elements and triangles name nodes that are there."""
        pairs = {"points": "node_region", "tetrahedra": "element_layer", "cavity_triangles": "cavity_of_triangle"}
        for whole, part in pairs.items():
            length, expected = len(getattr(self, part)), len(getattr(self, whole))
            if length != expected:
                raise ArtifactError(f"mesh of {self.robot_name}: {part} holds {length} values; expected {expected}, as {whole}")
        for name in ("tetrahedra", "cavity_triangles"):
            nodes, last = getattr(self, name), len(self.points) - 1
            if nodes.min(initial=0) < 0 or nodes.max(initial=0) > last:
                raise ArtifactError(
                    f"mesh of {self.robot_name}: {name} name nodes {nodes.min()} to {nodes.max()}; expected 0 to {last}"
                )


def tetrahedron_volumes(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the signed volumes (elements,) in m^3 of ``tetrahedra`` (elements, 4) over ``points`` (nodes, 3) m."""
    corner = points[tetrahedra]
    edges = corner[:, 1:] - corner[:, :1]
    return np.linalg.det(edges) / 6.0


def _is_closed(triangles: np.ndarray) -> bool:
    """Return whether every edge of ``triangles`` (triangles, 3) is passed as often one way as the other."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, which = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    return not np.bincount(which.reshape(-1), weights=np.sign(edges[:, 1] - edges[:, 0])).any()
