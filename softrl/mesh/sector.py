"""A solid with the symmetry of its chambers: one sector is meshed, and its images make the rest.

Any other mesh of such a solid is a little lopsided, and what is computed on it holds for none of its images.
"""

import logging
from typing import NamedTuple

import manifold3d
import numpy as np
from manifold3d import CrossSection, Manifold
from scipy.spatial import cKDTree

from softrl.artifacts.mesh import tetrahedron_volumes
from softrl.core.errors import MeshError
from softrl.mesh.cavity import find_cavities
from softrl.mesh.surface import Surface, orient_shells
from softrl.mesh.tetrahedra import MM, Tetrahedra, TetrahedraSettings, tetrahedralize, tidy
from softrl.robots.robot import Robot
from softrl.robots.symmetry import images_of

log = logging.getLogger(__name__)
LOPSIDED = 1e-3  # of the volume: what a solid and its image may not share
DRAWS = 6  # fTetWild draws random numbers; so many sectors take half as long again as the whole sample robot
STRAY = 1.2  # envelopes from its plane a node of the cut may lie
FACING = 0.5  # least cosine between a face of the cut and its plane
CRUSHED = 1e-6  # of the median volume: an element is left with less
SAME_M = 1e-7


class Sector(NamedTuple):
    """The part of a solid between two planes through the z axis.

    Attributes
    ----------
    surface : of the part
    inward : (2, 3) unit normals of the planes, into the part
    images : (k, 3, 3) turns and mirrors that make the solid of the part, the identity first
    """

    surface: Surface
    inward: np.ndarray
    images: np.ndarray


def fill(surface: Surface, robot: Robot, settings: TetrahedraSettings) -> Tetrahedra:
    """Return the tetrahedra of the solid that ``surface`` bounds, as symmetric as it is."""
    sector = sector_of(surface, robot)
    if sector is None:
        return tetrahedralize(surface, settings)
    drawn = [whole for _ in range(DRAWS) if (whole := _draw(sector, robot, settings)) is not None]
    drawn.sort(key=lambda whole: abs(whole.volume() - surface.volume()))
    fullest = drawn[: (len(drawn) + 1) // 2]
    return min(fullest, key=lambda whole: len(whole.points), default=None) or tetrahedralize(surface, settings)


def _draw(sector: Sector, robot: Robot, settings: TetrahedraSettings) -> Tetrahedra | None:
    """Return the solid of one mesh of the sector, or None if that cannot be mirrored."""
    try:
        whole = whole_of(tetrahedralize(sector.surface, settings), sector, STRAY * settings.envelope_m)
        find_cavities(whole, robot, "the mirrored sector")
    except MeshError as failure:
        log.info("a mesh of one sector is left out: %s", failure)
        return None
    return whole


def sector_of(surface: Surface, robot: Robot) -> Sector | None:
    """Return half the share of the first chamber of the solid, or None if the solid is not symmetric."""
    n, images = robot.chambers, [np.eye(3), *(image.vector for image in images_of(robot))]
    if n < 2 or len(images) < 2 * n:  # not evenly on a ring, or not about z
        return None
    begin = np.deg2rad(np.mod(robot.chamber_angle_deg, 360.0).min())
    end = begin + np.pi / n
    inward = np.array([[-np.sin(begin), np.cos(begin), 0.0], [np.sin(end), -np.cos(end), 0.0]])
    solid = Manifold(manifold3d.Mesh((MM * surface.points).astype(np.float32), surface.triangles.astype(np.uint32)))
    if solid.status() != manifold3d.Error.NoError or any(_differs(solid, image) for image in images):
        return None
    reach = 2.0 * MM * np.linalg.norm(surface.points, axis=1).max() / np.cos(np.pi / (2 * n))
    corners = reach * np.array([[0.0, 0.0], [np.cos(begin), np.sin(begin)], [np.cos(end), np.sin(end)]])
    part = solid ^ CrossSection([corners]).extrude(2.0 * reach).translate((0, 0, -reach))
    return Sector(surface_of(part), inward, np.array(images))


def surface_of(solid: Manifold) -> Surface:
    """Return the surface, m, of a solid in mm, its cavities' shells facing inward."""
    mesh = solid.to_mesh()
    points = np.asarray(mesh.vert_properties, float)[:, :3] / MM
    return orient_shells(Surface(points, np.asarray(mesh.tri_verts, np.int64)))


def whole_of(part: Tetrahedra, sector: Sector, tolerance_m: float) -> Tetrahedra:
    """Return the solid of ``part`` and its images, after the nodes of its cuts were moved onto their planes.

    An element of which a cut makes a flat one is dropped: its other faces are the cut then.

    Raises
    ------
    MeshError
        If an element is crushed by that, or a node lies in the next image.
    """
    points, cuts = part.points.copy(), [_cut(part, normal, tolerance_m) for normal in sector.inward]
    for nodes, normal in zip(cuts, sector.inward, strict=True):
        points[nodes] -= np.outer(points[nodes] @ normal, normal)
    points[np.intersect1d(*cuts), :2] = 0.0
    before, after = (tetrahedron_volumes(nodes, part.corners) for nodes in (part.points, points))
    flat = np.any([np.isin(part.corners, nodes).all(axis=1) for nodes in cuts], axis=0)
    crushed = int((after[~flat] < CRUSHED * np.median(before)).sum())
    beyond = int((points @ sector.inward.T < -SAME_M).any(axis=1).sum())
    if crushed or beyond:
        raise MeshError(f"{crushed} elements would be crushed at its cuts, and {beyond} nodes lie beyond them")
    kept = part.corners[~flat]
    copies = np.concatenate([points @ image.T for image in sector.images])
    corners = [
        kept[:, [0, 1, 2, 3] if np.linalg.det(image) > 0.0 else [0, 2, 1, 3]] + k * len(points)
        for k, image in enumerate(sector.images)
    ]
    first = np.array([min(same) for same in cKDTree(copies).query_ball_point(copies, SAME_M)])
    return tidy(copies, first[np.concatenate(corners)])


def _cut(part: Tetrahedra, normal: np.ndarray, tolerance_m: float) -> np.ndarray:
    """Return the nodes of the boundary faces that lie on the plane with the inward ``normal``."""
    faces = part.boundary()
    a, b, c = part.points[faces].transpose(1, 0, 2)
    outward = np.cross(b - a, c - a)
    facing = -(outward @ normal) > FACING * np.linalg.norm(outward, axis=1)
    near = np.abs(part.points[faces] @ normal).max(axis=1) < tolerance_m
    return np.unique(faces[facing & near])


def _differs(solid: Manifold, image: np.ndarray) -> bool:
    moved = solid.transform(np.c_[image, np.zeros(3)])
    return bool((solid - moved).volume() > LOPSIDED * solid.volume())
