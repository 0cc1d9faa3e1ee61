"""From a closed surface to tetrahedra of the solid, and from tetrahedra back to their boundary."""

import logging
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softrl.artifacts.mesh import tetrahedron_volumes
from softrl.core.errors import ConfigError, MeshError
from softrl.mesh import tetwild
from softrl.mesh.surface import Surface

log = logging.getLogger(__name__)
FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))  # corners of a tetrahedron's faces, normals outward
MM = 1e3
LARGEST_VOLUME_ERROR = 0.1  # of the tetrahedra against the surface they fill
# of a body's mean wall and height, where nobody says otherwise; a thick body's cavities are smaller than its walls
EDGE_WALLS, EDGE_HEIGHTS, ENVELOPE_WALLS, ENVELOPE_EDGES = 3.0, 1.0 / 7.0, 0.125, 0.1


@dataclass(frozen=True)
class TetrahedraSettings:
    """What fTetWild aims at.

    Attributes
    ----------
    edge_m : length of an edge where nothing asks for a shorter one
    envelope_m : the result's surface stays this close to the given one
    stop_energy : optimisation ends when the worst element's AMIPS energy is below this (a regular one has 3)
    """

    edge_m: float
    envelope_m: float
    stop_energy: float

    def __post_init__(self) -> None:
        if not 0 < self.envelope_m < self.edge_m:
            raise ConfigError(
                f"stage.tetrahedra.envelope_m={self.envelope_m:g}, edge_m={self.edge_m:g}; expected 0 < envelope < edge"
            )
        if self.stop_energy <= 3:
            raise ConfigError(
                f"stage.tetrahedra.stop_energy={self.stop_energy:g}; expected above 3 (a regular element)"
            )


@dataclass(frozen=True)
class TetrahedraWanted:
    """What is said about ``TetrahedraSettings``; null where it is left to the body at hand."""

    edge_m: float | None
    envelope_m: float | None
    stop_energy: float

    def or_else(self, edge_m: float, envelope_m: float) -> TetrahedraSettings:
        """Return the settings, with the given lengths where nothing is said."""
        edge = edge_m if self.edge_m is None else self.edge_m
        envelope = envelope_m if self.envelope_m is None else self.envelope_m
        return TetrahedraSettings(edge, envelope, self.stop_energy)

    def of_walls(self, surface: Surface) -> TetrahedraSettings:
        """Return the settings, by the walls and the height of the solid that ``surface`` bounds where nothing is said."""
        wall, height = surface.wall(), float(np.ptp(surface.points[:, 2]))
        edge = min(EDGE_WALLS * wall, EDGE_HEIGHTS * height) if self.edge_m is None else self.edge_m
        made = self.or_else(edge, min(ENVELOPE_WALLS * wall, ENVELOPE_EDGES * edge))
        log.info(
            "walls of %.1f mm on average: stage.tetrahedra.edge_m=%.4f, envelope_m=%.5f", MM * wall, made.edge_m, made.envelope_m
        )
        return made


@dataclass(frozen=True)
class Tetrahedra:
    """Linear tetrahedra of the solid: ``points`` (nodes, 3) m, ``corners`` (elements, 4) node numbers."""

    points: np.ndarray
    corners: np.ndarray

    def volume(self) -> float:
        """Return the volume of the solid in m^3."""
        return float(tetrahedron_volumes(self.points, self.corners).sum())

    def boundary(self) -> np.ndarray:
        """Return the triangles (triangles, 3) that belong to one tetrahedron only, normals out of the solid."""
        faces = np.concatenate([self.corners[:, list(face)] for face in FACES])
        _, first, uses = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        if (uses > 2).any():
            raise MeshError(
                f"{int((uses > 2).sum())} faces belong to three or more tetrahedra; expected two at most: "
                "remove repeated or overlapping elements"
            )
        return faces[first[uses == 1]]


def tetrahedralize(surface: Surface, settings: TetrahedraSettings) -> Tetrahedra:
    """Return the tetrahedra of the solid that ``surface`` bounds; its cavities stay empty.

    Notes
    -----
    fTetWild keeps what has winding number one: cavity shells must face inward (``surface.orient_shells``).
    fTetWild draws from the system's random numbers: two runs on one surface differ by a few per cent in nodes
    and by about 0.2 % in volume, so a mesh that must not change is kept, not made again.
    """
    points, corners = _run_tetwild(surface, settings)
    if not len(corners):
        raise MeshError("fTetWild kept no tetrahedra: the surface encloses no volume; check that it is closed")
    made = tidy(points / MM, corners)
    error = made.volume() / surface.volume() - 1.0
    nodes, elements = len(made.points), len(made.corners)
    log.info("fTetWild made %d nodes, %d tetrahedra; volume %+.1f %% off the surface's", nodes, elements, 100 * error)
    if abs(error) > LARGEST_VOLUME_ERROR:
        raise MeshError(
            f"the tetrahedra fill {1e6 * made.volume():.1f} cm3 but the surface encloses "
            f"{1e6 * surface.volume():.1f} cm3; lower stage.tetrahedra.envelope_m (thinner walls than it are lost)"
        )
    return made


def _run_tetwild(surface: Surface, settings: TetrahedraSettings) -> tuple[np.ndarray, np.ndarray]:
    """Return points (nodes, 3) mm and tetrahedra (elements, 4) from fTetWild in a process of its own."""
    diagonal = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "surface.npz", Path(folder) / "tetrahedra.npz"
        np.savez(
            source,
            points=MM * surface.points,
            triangles=surface.triangles.astype(np.int32),
            edge=MM * settings.edge_m,
            envelope_share=settings.envelope_m / diagonal,
            stop_energy=settings.stop_energy,
        )
        # -P: the modules beside the program must not hide others of the same name
        command = [sys.executable, "-P", str(tetwild.__file__), str(source), str(target)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode or not target.is_file():
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise MeshError(
                f"fTetWild failed with exit status {done.returncode} ({last}); "
                "check the surface for self-intersections, or change stage.tetrahedra"
            )
        with np.load(target, allow_pickle=False) as data:
            return data["points"], data["tetrahedra"]


def tidy(points: np.ndarray, corners: np.ndarray) -> Tetrahedra:
    """Return the tetrahedra with unused points dropped, turned to positive volume if the file's order is the other.

    Single inverted elements among others stay as they are: they are an error of the mesh, not a convention.
    """
    used, number = np.unique(corners, return_inverse=True)
    corners, points = number.reshape(corners.shape).astype(np.int64), np.asarray(points, float)[used]
    if np.median(tetrahedron_volumes(points, corners)) < 0:
        corners = corners[:, [0, 2, 1, 3]]
    return Tetrahedra(points, corners)
