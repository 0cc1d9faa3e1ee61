"""Where the planar links of the chain are, from the mesh's ribs or from the robot's own numbers."""

from typing import NamedTuple

import numpy as np

from softrl.artifacts.mesh import BASE, FIRST_RIB, PLATE, Mesh
from softrl.robots.robot import Robot


class Dimensions(NamedTuple):
    """Heights (gaps,) m of hinges and planar links, their radii (gaps,) m, the neck's radius and the tip's height, m."""

    joint_height: np.ndarray
    plane_height: np.ndarray
    plane_radius: np.ndarray
    neck_radius: float
    tip_height: float


def dimensions_of(robot: Robot, mesh: Mesh | None, tip_height: float, links: int) -> Dimensions:
    """Return the chain's dimensions; ``links`` planar links share the length evenly where no mesh shows ribs.

    Notes
    -----
    One planar link per rib, the hinges of a gap half-way up the soft wall below it. The wall starts where the first rib's
    cavity starts, and the plate belongs to the last link, so that a robot of six bulges has six links and six gaps.
    """
    robot.check_upright("the surrogate")
    ribs = [] if mesh is None else [r for r in np.unique(mesh.node_region) if r >= FIRST_RIB]
    if mesh is None or not ribs:
        return _even(robot, tip_height, links)
    planes = [_plane(mesh.points[mesh.node_region == r]) for r in ribs]
    height = np.array([p[0] for p in planes])
    order = np.argsort(height)
    height, radius = height[order], np.array([p[1] for p in planes])[order]
    joint = height - 0.5 * np.diff(height, prepend=_soft_from(mesh))
    return Dimensions(joint, height, radius, _neck_radius(mesh), tip_height)


def _even(robot: Robot, tip_height: float, links: int) -> Dimensions:
    pitch = tip_height / links
    plane = pitch * np.arange(1, links + 1)
    radius = np.full(links, robot.chamber_radius_m)
    return Dimensions(plane - 0.5 * pitch, plane, radius, 0.5 * robot.chamber_radius_m, tip_height)


def _plane(points: np.ndarray) -> tuple[float, float]:
    """Return the height on the z axis of the regression plane of ``points`` (nodes, 3) m, and the largest radius in it."""
    design = np.column_stack([points[:, :2], np.ones(len(points))])
    height = np.linalg.lstsq(design, points[:, 2], rcond=None)[0][2]
    return float(height), float(np.hypot(points[:, 0], points[:, 1]).max())


def _soft_from(mesh: Mesh) -> float:
    """Return the height from which the body bends: the lowest point of the cavities, above the fixed base."""
    cavity = mesh.points[mesh.cavity_triangles, 2].min()
    base = mesh.points[mesh.node_region == BASE, 2]
    return float(max(cavity, base.max() if len(base) else cavity))


def _neck_radius(mesh: Mesh) -> float:
    """Return the smallest radius of a cavity about its own axis, over its length: how wide the bellows' necks are."""
    smallest = np.inf
    for chamber in range(mesh.chambers):
        points = mesh.points[np.unique(mesh.cavity_triangles[mesh.cavity_of_triangle == chamber])]
        centre = 0.5 * (points[:, :2].min(axis=0) + points[:, :2].max(axis=0))
        radius, height = np.linalg.norm(points[:, :2] - centre, axis=1), points[:, 2]
        edges = np.linspace(height.min(), height.max(), 41)[2:-2]  # the closed ends shrink to nothing
        bins = np.digitize(height, edges)
        smallest = min([smallest] + [radius[bins == i].max() for i in range(1, len(edges)) if (bins == i).any()])
    return float(smallest) if np.isfinite(smallest) else float(mesh.points[mesh.node_region == PLATE, :2].max())
