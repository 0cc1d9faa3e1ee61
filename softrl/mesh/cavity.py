"""Cavities of a solid: shells of its boundary that enclose negative volume, one for each chamber."""

import logging
from typing import NamedTuple

import numpy as np

from softrl.core.errors import MeshError
from softrl.mesh.surface import Surface, centroid, enclosed_volume, label_shells
from softrl.mesh.tetrahedra import Tetrahedra
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
CM3 = 1e6
TURNED_DEG = 5.0  # from here on a cavity is told to lie beside its chamber
ACROSS_DEG = 90.0  # beyond that pressure bends the body away from where its robot's file says
ASIDE = 0.04  # of the body's width: a single cavity nearer to its middle lies on no side


class Cavities(NamedTuple):
    """``triangles`` (triangles, 3), normals into the cavity, and their ``chamber`` (triangles,) from 0."""

    triangles: np.ndarray
    chamber: np.ndarray


def find_cavities(solid: Tetrahedra, robot: Robot, name: str) -> Cavities:
    """Return the cavities of ``solid`` in the order of the robot's chambers.

    Parameters
    ----------
    name : the mesh's name in error messages

    Raises
    ------
    MeshError
        If the cavities are filled, too few or too many, open, touch each other or the outside, or lie at
        other angles than the robot's chambers.
    """
    return cavities_of(Surface(solid.points, solid.boundary()), robot, name)


def cavities_of(boundary: Surface, robot: Robot, name: str) -> Cavities:
    """Return the cavities among the shells of a closed ``boundary``; raises like ``find_cavities``."""
    shells = split_shells(boundary.triangles)
    volume = np.array([enclosed_volume(boundary.points, shell) for shell in shells])
    _check_touch(boundary.points, shells, name)
    _check_numbers(volume, robot, name)
    cavities = [shell for shell, v in zip(shells, volume, strict=True) if v < 0]
    centre = np.array([centroid(boundary.points, cavity) for cavity in cavities])
    if robot.chambers == 1:
        _check_side(centre[0], boundary.points, robot, name)
    order = match_chambers(centre, robot, name)
    ordered = [cavities[i] for i in order]
    chamber = np.repeat(np.arange(len(ordered)), [len(c) for c in ordered])
    return Cavities(np.concatenate(ordered), chamber)


def split_shells(triangles: np.ndarray) -> list[np.ndarray]:
    """Return the triangles of each connected shell."""
    label = label_shells(triangles)
    return [triangles[label == k] for k in range(label.max() + 1)]


def _check_touch(points: np.ndarray, shells: list[np.ndarray], name: str) -> None:
    seen = np.concatenate([np.unique(shell) for shell in shells])
    node, uses = np.unique(seen, return_counts=True)
    if (uses > 1).any():
        at = 1e3 * points[node[uses > 1][0]]
        raise MeshError(
            f"a cavity touches the outside or another cavity in {int((uses > 1).sum())} nodes of {name}, the first at "
            f"({at[0]:.1f}, {at[1]:.1f}, {at[2]:.1f}) mm; expected a wall around every cavity: refine the mesh there "
            "(a surface is meshed finer with a smaller stage.tetrahedra.envelope_m)"
        )


def _check_numbers(volume: np.ndarray, robot: Robot, name: str) -> None:
    solids, cavities = volume[volume > 0], -volume[volume < 0]
    if len(solids) != 1:
        parts = ", ".join(f"{CM3 * v:.1f}" for v in solids)
        raise MeshError(f"{name} falls into {len(solids)} separate solids ({parts} cm3); expected one connected body")
    if not len(cavities):
        raise MeshError(
            f"{name} has no cavity: its boundary is one outer surface that encloses {CM3 * solids[0]:.1f} cm3, so the "
            f"{robot.chambers} chambers are filled with material (or open to the outside); give the watertight surface "
            "with its cavities instead (stage.source=<file>.stl), or the cavities' surfaces in stage.cavity_surfaces"
        )
    if len(cavities) != robot.chambers:
        found = ", ".join(f"{CM3 * v:.2f}" for v in cavities)
        raise MeshError(
            f"{name} has {len(cavities)} cavities ({found} cm3), but robot {robot.name} has {robot.chambers} chambers; "
            "a chamber that is open to the outside is no cavity: close it, or fill what is no chamber"
        )


def _check_side(centre: np.ndarray, points: np.ndarray, robot: Robot, name: str) -> None:
    """Warn where the one cavity with ``centre`` (3,) m lies beside its chamber, raise ``MeshError`` where it lies across.

    A cavity in the middle of the body's ``points`` (nodes, 3) m lies on no side: there the walls say whereto it bends.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    aside = centre[:2] - 0.5 * (low + high)
    if np.linalg.norm(aside) < ASIDE * (high - low).max():
        return
    angle, wanted = np.rad2deg(np.arctan2(aside[1], aside[0])), robot.chamber_angle_deg[0]
    off = degrees_apart(np.array([wanted]), np.array([angle])).item()
    told = f"{name} has its cavity at {angle:z.0f} deg around z, but robot {robot.name} has its chamber at {wanted:g} deg"
    advice = "turn the mesh, or set robot.chamber_angle_deg"
    if off > ACROSS_DEG:
        raise MeshError(f"{told}; {advice}")
    if off >= TURNED_DEG:
        log.warning("%s: it bends where its cavity is; if the two should agree, %s", told, advice)


def match_chambers(centre: np.ndarray, robot: Robot, name: str) -> list[int]:
    """Return for each chamber the number of the cavity whose ``centre`` (cavities, 3) m lies at its angle."""
    if robot.chambers == 1:
        return [0]
    angle = np.rad2deg(np.arctan2(centre[:, 1], centre[:, 0]))
    wanted = np.array(robot.chamber_angle_deg)
    apart = degrees_apart(wanted, angle)
    nearest, off = apart.argmin(axis=1), apart.min(axis=1)
    # half of what separates two chambers, with a margin: nearer to its own chamber than to any other
    allowed = 0.4 * 360.0 / robot.chambers
    found, asked = ", ".join(f"{a:z.0f}" for a in angle), ", ".join(f"{a:g}" for a in wanted)
    advice = "turn the mesh, or set robot.chamber_angle_deg"
    if len(set(nearest.tolist())) < robot.chambers or off.max() > allowed:
        raise MeshError(
            f"{name} has its cavities at {found} deg around z, but robot {robot.name} has its chambers at {asked} deg; {advice}"
        )
    if off.max() >= TURNED_DEG:
        log.warning(
            "%s has its cavities at %s deg around z, up to %.0f deg from the chambers of robot %s at %s deg: it bends where its "
            "cavities are; if they should agree, %s", name, found, off.max(), robot.name, asked, advice,
        )  # fmt: skip
    return [int(i) for i in nearest]


def degrees_apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles (k, m) in 0 .. 180 deg between directions ``first`` (k,) and ``second`` (m,) deg around an axis."""
    return np.asarray(np.abs((first[:, None] - second[None, :] + 180.0) % 360.0 - 180.0))
