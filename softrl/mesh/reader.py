"""A user's own mesh or surface, in any format that meshio reads."""

import logging
from pathlib import Path

import meshio
import numpy as np

from softrl.core.errors import MeshError
from softrl.mesh.surface import Surface, check_closed, merge_points, orient_shells
from softrl.mesh.tetrahedra import Tetrahedra, tidy
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
UNITS_M = {"m": 1.0, "inch": 0.0254, "cm": 0.01, "mm": 0.001, "um": 1e-6}
SIZE_FACTOR = 4.0  # a mesh this much longer or shorter than its robot is in another unit
STANDS_SHARE = 0.05  # of its height: so far from z = 0 the lowest point of a body may be
MERGE_SHARE = 1e-6  # corners closer than this share of the mesh's size are one node


def read_mesh(path: Path, unit_m: float, robot: Robot) -> Tetrahedra | Surface:
    """Return the tetrahedra of a volume mesh, or the closed oriented surface of a file that holds triangles only.

    Parameters
    ----------
    unit_m : the length in metres of one unit of the file's coordinates
    robot : its length shows whether the unit can be right

    Raises
    ------
    MeshError
        If the file cannot be read, holds neither tetrahedra nor triangles, is open, or has another unit.
    """
    content = _read(path)
    points = np.asarray(content.points, float)
    if points.shape[1] != 3 or not np.isfinite(points).all():
        raise MeshError(f"{path} has points of shape {points.shape} or not finite; expected finite x, y, z")
    cells = _cells(content, path)
    check_unit(points[np.unique(cells)], unit_m, robot, path.name)
    if cells.shape[1] == 4:
        return tidy(unit_m * points, cells)
    return read_shells(unit_m * points, cells, path.name)


def read_shells(points: np.ndarray, triangles: np.ndarray, name: str) -> Surface:
    """Return the closed surface of ``triangles`` over ``points`` m, its cavity shells turned inward."""
    size = float(np.ptp(points, axis=0).max())
    surface = merge_points(points, triangles, MERGE_SHARE * size)
    check_closed(surface.triangles, surface.points, name)
    return orient_shells(surface)


def read_surface(path: Path, unit_m: float) -> Surface:
    """Return the closed surface in ``path`` without a look at its size: for single cavities."""
    content = _read(path)
    cells = _cells(content, path)
    if cells.shape[1] == 4:
        raise MeshError(f"{path} holds tetrahedra; expected the surface of a cavity")
    return read_shells(unit_m * np.asarray(content.points, float), cells, path.name)


def join_surfaces(outer: Surface, cavities: list[Surface]) -> Surface:
    """Return one surface of ``outer`` and ``cavities``, every shell turned as its nesting demands."""
    points, triangles, offset = [], [], 0
    for part in [outer, *cavities]:
        points.append(part.points)
        triangles.append(part.triangles + offset)
        offset += len(part.points)
    return orient_shells(Surface(np.concatenate(points), np.concatenate(triangles)))


def check_unit(points: np.ndarray, unit_m: float, robot: Robot, name: str) -> None:
    """Raise ``MeshError`` if ``points`` (nodes, 3) in units of ``unit_m`` cannot be a body as long as ``robot``."""
    size = float(np.ptp(points[:, 2]))
    ratio = size * unit_m / robot.length_m
    if 1.0 / SIZE_FACTOR < ratio < SIZE_FACTOR:
        return
    fits = [f"{value:g} ({unit})" for unit, value in UNITS_M.items() if 0.5 < size * value / robot.length_m < 2.0]
    advice = "check stage.unit_m, robot.length_m and that z runs along the robot"
    if fits:
        advice = f"set stage.unit_m={' or '.join(fits)}"
    raise MeshError(
        f"{name} is {size * unit_m:.4g} m high with stage.unit_m={unit_m:g}, but robot {robot.name} is "
        f"{robot.length_m:g} m long (factor {ratio:.3g}); {advice}"
    )


def check_standing(points: np.ndarray, name: str) -> None:
    """Raise ``MeshError`` if a body with ``points`` (nodes, 3) m does not begin at z = 0, where its base is clamped."""
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    if abs(low) > STANDS_SHARE * (high - low):
        advice = "turn it over, its base down" if abs(high) <= STANDS_SHARE * (high - low) else "move its base to z = 0"
        raise MeshError(
            f"{name} reaches from z = {1e3 * low:.1f} to {1e3 * high:.1f} mm; expected it to stand on z = 0, where it is "
            f"clamped, and to rise along +z: {advice}"
        )


def _read(path: Path) -> meshio.Mesh:
    if not path.is_file():
        raise MeshError(f"{path} does not exist; expected sample, generate, or the path of a mesh file in stage.source")
    try:
        with np.errstate(over="ignore"):  # meshio guesses whether an STL is binary from an integer that may overflow
            return meshio.read(path)
    # meshio leaves by SystemExit when no reader accepts the file, and its readers raise what they stumble over
    except (SystemExit, meshio.ReadError, ValueError, KeyError, IndexError, UnicodeDecodeError, EOFError) as error:
        raise MeshError(
            f"{path} cannot be read as a mesh ({error or 'no reader accepts it'}); "
            "expected VTK, VTU, MSH, STL, PLY, OBJ or another format of meshio"
        ) from error


def _cells(content: meshio.Mesh, path: Path) -> np.ndarray:
    """Return the tetrahedra (elements, 4), or else the triangles (triangles, 3); of quadratic ones the corners."""
    for kinds, corners in ((("tetra", "tetra10"), 4), (("triangle", "triangle6"), 3)):
        blocks = [block.data[:, :corners] for block in content.cells if block.type in kinds and len(block.data)]
        if blocks:
            _refuse_others(content, kinds, corners - 1, path)
            return np.concatenate(blocks).astype(np.int64)
    found = ", ".join(sorted({block.type for block in content.cells})) or "nothing"
    raise MeshError(f"{path} holds no tetrahedra and no triangles ({found}); export it with one of the two")


def _refuse_others(content: meshio.Mesh, kinds: tuple[str, ...], dimension: int, path: Path) -> None:
    """Raise ``MeshError`` if there are elements of ``dimension`` beside ``kinds``: left out, they would look like cavities."""
    others = {block.type for block in content.cells if block.dim == dimension and block.type not in kinds and len(block.data)}
    if others:
        found = ", ".join(sorted(others))
        raise MeshError(f"{path} holds {found} beside {kinds[0]}; expected {kinds[0]} alone: export all elements as these")
