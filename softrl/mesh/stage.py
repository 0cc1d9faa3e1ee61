"""The volume mesh of a robot: the tripod by parameters, its sample, or a user's own mesh or surface."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softrl.artifacts.mesh import BASE, Mesh
from softrl.core.errors import ConfigError
from softrl.core.tracking import Tracker
from softrl.mesh.cavity import Cavities, cavities_of, find_cavities
from softrl.mesh.figures import draw_cuts, draw_quality
from softrl.mesh.geometry import TripodGeometry, build_tripod
from softrl.mesh.quality import check_orientation, check_slivers, smallest_dihedral
from softrl.mesh.reader import check_standing, join_surfaces, read_mesh, read_surface
from softrl.mesh.region import Regions, RegionSettings, layer_of_elements, tag_nodes
from softrl.mesh.sample import read_sample
from softrl.mesh.sector import fill
from softrl.mesh.surface import Surface
from softrl.mesh.tetrahedra import Tetrahedra, TetrahedraSettings, TetrahedraWanted
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
SAMPLE, GENERATE = "sample", "generate"
ASIDE = 0.05  # of the body's width: so far beside the z axis its base may stand


@dataclass(frozen=True)
class Config:
    """Where the mesh comes from, how fine it is and where its rigid parts are.

    Attributes
    ----------
    source : ``sample`` (a committed coarse mesh of the tripod, refused for other robots), ``generate`` (the tripod by
        ``geometry``), or the path of a volume mesh or closed surface in a format of meshio
    unit_m : length in m of one unit in the files of ``source`` and ``cavity_surfaces``
    cavity_surfaces : files with the surfaces of single cavities, if ``source`` shows the outside only
    min_dihedral_deg : a mesh with a flatter element is refused
    tetrahedra : edge length and envelope, where a surface is to be meshed; where null, of the tripod those of its geometry,
        of the user's own surface by its walls
    geometry : measures of the tripod
    regions : where base, plate and ribs are; where null, those of the geometry if the mesh is made of it or the robot may be
        that tripod, else the ends
    """

    source: str
    unit_m: float
    cavity_surfaces: tuple[str, ...]
    min_dihedral_deg: float
    tetrahedra: TetrahedraWanted
    geometry: TripodGeometry
    regions: RegionSettings

    def __post_init__(self) -> None:
        if self.unit_m <= 0:
            raise ConfigError(f"stage.unit_m={self.unit_m:g} must be positive: 0.001 for a file in mm")
        if not 0.0 <= self.min_dihedral_deg < 70.0:
            raise ConfigError(
                f"stage.min_dihedral_deg={self.min_dihedral_deg:g}; expected 0 to 70 (a regular tetrahedron has 70.5)"
            )
        if self.cavity_surfaces and self.source in (SAMPLE, GENERATE):
            raise ConfigError(f"stage.cavity_surfaces is given, but stage.source={self.source} brings its own cavities")

    def of_tripod(self) -> TetrahedraSettings:
        """Return the settings of the tripod's tetrahedra."""
        return self.tetrahedra.or_else(self.geometry.edge_m, self.geometry.envelope_m)

    def regions_of(self, points: np.ndarray, robot: Robot) -> Regions:
        """Return where base, plate and ribs of a body with ``points`` (nodes, 3) m are."""
        of_geometry = self.source in (SAMPLE, GENERATE) or self.geometry.is_of(robot)
        return self.regions.of_tripod(self.geometry) if of_geometry else self.regions.of_ends(points)


def run(config: Config, robot: Robot, *, tracker: Tracker) -> Mesh:
    """Return the robot's mesh with its regions and cavities, checked; log sizes, volumes and quality."""
    robot.check_upright("stage=mesh")
    name = config.source if config.source in (SAMPLE, GENERATE) else Path(config.source).name
    body = _body(config, robot)
    regions = config.regions_of(body.points, robot)
    solid = body if isinstance(body, Tetrahedra) else _filled(body, config, robot, name)
    check_orientation(solid, name)
    cavities = find_cavities(solid, robot, name)
    check_slivers(solid, config.min_dihedral_deg, name)
    mesh = _assemble(regions, robot, solid, cavities, name)
    mesh.validate()
    _warn_aside(mesh, name)
    _report(mesh, solid, regions, config.min_dihedral_deg, robot, tracker)
    return mesh


def _body(config: Config, robot: Robot) -> Tetrahedra | Surface:
    if config.source == SAMPLE:
        return read_sample(config.geometry, config.of_tripod(), robot)
    return build_tripod(config.geometry, robot) if config.source == GENERATE else _read_own(config, robot)


def _filled(surface: Surface, config: Config, robot: Robot, name: str) -> Tetrahedra:
    cavities_of(surface, robot, name)  # a wrong surface is refused before it is meshed
    settings = config.of_tripod() if config.source == GENERATE else config.tetrahedra.of_walls(surface)
    return fill(surface, robot, settings)


def _read_own(config: Config, robot: Robot) -> Tetrahedra | Surface:
    body = read_mesh(Path(config.source), config.unit_m, robot)
    check_standing(body.points, Path(config.source).name)
    if not config.cavity_surfaces:
        return body
    outside = Surface(body.points, body.boundary()) if isinstance(body, Tetrahedra) else body
    return join_surfaces(outside, [read_surface(Path(path), config.unit_m) for path in config.cavity_surfaces])


def _assemble(regions: Regions, robot: Robot, solid: Tetrahedra, cavities: Cavities, name: str) -> Mesh:
    rigid = f"base up to {1e3 * regions.base_below_m:.1f} mm, plate from {1e3 * regions.plate_from_m:.1f} mm on"
    log.info("%s, %d ribs (stage.regions)", rigid, len(regions.rib_from_m))
    return Mesh(
        points=solid.points,
        tetrahedra=solid.corners,
        node_region=tag_nodes(solid.points, regions, name),
        element_layer=layer_of_elements(solid.points, solid.corners, regions),
        cavity_triangles=cavities.triangles,
        cavity_of_triangle=cavities.chamber,
        robot_name=robot.name,
    )


def _warn_aside(mesh: Mesh, name: str) -> None:
    """Warn of a body that stands beside the z axis, which is that of the chambers' angles and of their symmetries."""
    at = mesh.points[mesh.node_region == BASE, :2].mean(axis=0)
    if np.linalg.norm(at) > ASIDE * np.ptp(mesh.points[:, :2], axis=0).max():
        log.warning(
            "%s has the centre of its base at x = %.1f, y = %.1f mm; expected it on the z axis, about which the robot's chambers "
            "are told: move the mesh there, unless the body is meant to stand aside", name, *(1e3 * at),
        )  # fmt: skip


def _report(
    mesh: Mesh, solid: Tetrahedra, regions: Regions, least_deg: float, robot: Robot, tracker: Tracker
) -> None:
    angle = smallest_dihedral(solid)
    tracker.metric("nodes_count", len(mesh.points))
    tracker.metric("tetrahedra_count", len(mesh.tetrahedra))
    tracker.metric("volume_cm3", 1e6 * mesh.volume())
    tracker.metric("min_dihedral_deg", angle.min())
    tracker.metric("median_dihedral_deg", float(np.median(angle)))
    volumes = [1e6 * mesh.cavity_volume(chamber) for chamber in range(mesh.chambers)]
    for chamber, volume in enumerate(volumes):
        tracker.metric(f"cavity_{chamber + 1}_volume_cm3", volume)
    height = 0.5 * (regions.rib_from_m[0] + regions.rib_to_m[0]) if regions.rib_from_m else 0.5 * robot.length_m
    tracker.figure("cuts", draw_cuts(mesh, robot.chamber_angle_deg[0], height))
    tracker.figure("quality", draw_quality(angle, least_deg))
    size = f"{len(mesh.points)} nodes, {len(mesh.tetrahedra)} tetrahedra, {1e6 * mesh.volume():.1f} cm3 of solid"
    hollow = ", ".join(f"{v:.1f}" for v in volumes)
    log.info("%s, cavities of %s cm3, smallest dihedral angle %.1f deg", size, hollow, angle.min())
