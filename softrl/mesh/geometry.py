"""The tripod by parameters: three bellows on a circle, ribs that tie them, feet and a top plate."""

from dataclasses import dataclass
from itertools import pairwise

import manifold3d
import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from softrl.core.errors import ConfigError, MeshError
from softrl.mesh.sector import surface_of
from softrl.mesh.surface import Surface
from softrl.robots.robot import Robot

MM = 1e3  # the solid modeller works in mm, where its single precision is 1e-5
OTHER = 0.01  # of its length: a robot that differs by more is another
RIB_CORNERS = 3  # one a bellows: with fewer it is no polygon
PROFILE_POINTS = 9  # along one bulge; more would be finer than what the envelope of the tetrahedraliser keeps


@dataclass(frozen=True)
class TripodGeometry:
    """Measures of the tripod; the robot adds the angles and the radius of the circle that the bellows stand on.

    Attributes
    ----------
    bulges, bulge_pitch_m, bulge_first_m : number, distance and height of the first of the bulges of a bellows
    bulge_radius_m, bulge_half_height_m, bulge_exponent : the bulge's outside is a superellipse
        (r / radius)^e + (z / half height)^e = 1 around the bellows' axis
    neck_radius_m : outer radius between the bulges
    wall_m : thickness of the bellows' wall, measured along its normal
    bellows_from_m, bellows_to_m : heights of the bellows' closed ends
    cavity_from_m, cavity_to_m : heights at which the cavity ends
    stem_radius_m, foot_radius_m, foot_height_m : cylinders that join a bellows to base and plate
    rib_thickness_m, rib_inradius_m : a rib is a polygon with a corner towards each bellows, at each bulge's height
    plate_from_m, plate_to_m, plate_radius_m : the disc of the top plate
    plate_arm_width_m, plate_arm_reach_m : one arm of the plate above each bellows, reaching so far from the axis
    facets : corners of a circle; polygons keep the area of their circle
    edge_m, envelope_m : of the tetrahedra, where stage.tetrahedra leaves them to it
    """

    bulges: int
    bulge_pitch_m: float
    bulge_first_m: float
    bulge_radius_m: float
    bulge_half_height_m: float
    bulge_exponent: float
    neck_radius_m: float
    wall_m: float
    bellows_from_m: float
    bellows_to_m: float
    cavity_from_m: float
    cavity_to_m: float
    stem_radius_m: float
    foot_radius_m: float
    foot_height_m: float
    rib_thickness_m: float
    rib_inradius_m: float
    plate_from_m: float
    plate_to_m: float
    plate_radius_m: float
    plate_arm_width_m: float
    plate_arm_reach_m: float
    facets: int
    edge_m: float
    envelope_m: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value <= 0:
                raise ConfigError(f"stage.geometry.{name}={value:g} must be positive")
        if self.facets < 6:
            raise ConfigError(f"stage.geometry.facets={self.facets}; expected 6 or more corners of a circle")
        if not self.wall_m < self.neck_radius_m < self.bulge_radius_m:
            raise ConfigError(
                f"stage.geometry.wall_m={self.wall_m:g}, neck_radius_m={self.neck_radius_m:g}, "
                f"bulge_radius_m={self.bulge_radius_m:g}; expected them rising"
            )
        heights = ("bellows_from_m", "cavity_from_m", "cavity_to_m", "bellows_to_m", "plate_from_m", "plate_to_m")
        values = [getattr(self, name) for name in heights]
        if any(low >= high for low, high in pairwise(values)):
            raise ConfigError(f"stage.geometry: {', '.join(heights)} are {values}; expected them rising")

    def is_of(self, robot: Robot) -> bool:
        """Return whether ``robot`` may be this tripod: three chambers and as long."""
        return robot.chambers == 3 and abs(robot.length_m - self.plate_to_m) <= OTHER * self.plate_to_m

    @property
    def bulge_height(self) -> np.ndarray:
        """Heights (bulges,) of the bulges' middles in m."""
        return self.bulge_first_m + self.bulge_pitch_m * np.arange(self.bulges)


def build_tripod(geometry: TripodGeometry, robot: Robot) -> Surface:
    """Return the closed surface of the solid with its cavities, in the base frame, m."""
    if robot.chambers < RIB_CORNERS:
        raise ConfigError(
            f"stage.source=generate builds bellows around ribs, of {RIB_CORNERS} chambers or more; robot {robot.name} has "
            f"{robot.chambers}: give its mesh or surface, stage.source=<mesh>"
        )
    g = geometry
    solid, cavities = _plate(g, robot), Manifold()
    bellows, cavity = _bellows(g)
    for angle in robot.chamber_angle_deg:
        # a bellows is turned with its place, so that the surface has the symmetry of the robot
        solid += _stand(bellows + _feet(g), robot, angle)
        cavities += _stand(cavity, robot, angle)
    for height in g.bulge_height:
        solid += _rib(g, robot, height)
    return _as_surface(solid - cavities)


def _stand(leg: Manifold, robot: Robot, angle_deg: float) -> Manifold:
    return leg.translate((MM * robot.chamber_radius_m, 0, 0)).rotate((0, 0, angle_deg))


def _bellows(g: TripodGeometry) -> tuple[Manifold, Manifold]:
    """Return the filled bellows and its cavity around the z axis."""
    profile = _profile(g)
    # the half profile is mirrored before it is shrunk, so that the axis does not move
    inner = profile.offset(-MM * g.wall_m, JoinType.Miter)
    inner ^= _rectangle(-1.0, 1.0, g.cavity_from_m, g.cavity_to_m)
    return _revolve(profile, g.facets), _revolve(inner.simplify(0.05), g.facets)


def _profile(g: TripodGeometry) -> CrossSection:
    phase = np.linspace(-0.5 * np.pi, 0.5 * np.pi, PROFILE_POINTS)
    power = 2.0 / g.bulge_exponent
    radius = g.bulge_radius_m * np.abs(np.cos(phase)) ** power
    height = g.bulge_half_height_m * np.sign(np.sin(phase)) * np.abs(np.sin(phase)) ** power
    outline = MM * np.concatenate([np.c_[radius, height], np.c_[-radius, height][-2:0:-1]])
    profile = _rectangle(-g.neck_radius_m, g.neck_radius_m, g.bellows_from_m, g.bellows_to_m)
    for middle in g.bulge_height:
        profile += CrossSection([outline + np.array([0.0, MM * middle])])
    return profile ^ _rectangle(-1.0, 1.0, g.bellows_from_m, g.bellows_to_m)


def _revolve(profile: CrossSection, facets: int) -> Manifold:
    grow = _same_area(facets)
    return profile.scale((grow, 1.0)).revolve(facets)


def _same_area(facets: int) -> float:
    """Return the factor by which a regular polygon's corners stand off a circle of the same area."""
    return float(np.sqrt(2.0 * np.pi / facets / np.sin(2.0 * np.pi / facets)))


def _rectangle(x_from: float, x_to: float, y_from: float, y_to: float) -> CrossSection:
    corners = np.array([[x_from, y_from], [x_to, y_from], [x_to, y_to], [x_from, y_to]])
    return CrossSection([MM * corners])


def _cylinder(radius: float, z_from: float, z_to: float, facets: int) -> Manifold:
    radius *= MM * _same_area(facets)
    return Manifold.cylinder(MM * (z_to - z_from), radius, radius, facets).translate((0, 0, MM * z_from))


def _feet(g: TripodGeometry) -> Manifold:
    foot = _cylinder(g.foot_radius_m, 0.0, g.foot_height_m, g.facets)
    head = _cylinder(g.foot_radius_m, g.plate_from_m - g.foot_height_m, g.plate_from_m, g.facets)
    # the stems reach into wall and plate: faces that only touch would leave the parts apart
    below = _cylinder(g.stem_radius_m, 0.0, 0.5 * (g.bellows_from_m + g.cavity_from_m), g.facets)
    above = _cylinder(g.stem_radius_m, 0.5 * (g.cavity_to_m + g.bellows_to_m), g.plate_from_m, g.facets)
    return foot + head + below + above


def _rib(g: TripodGeometry, robot: Robot, height: float) -> Manifold:
    corners = g.rib_inradius_m / np.cos(np.pi / robot.chambers) * robot.chamber_direction
    outline = CrossSection([MM * corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]])
    return outline.extrude(MM * g.rib_thickness_m).translate((0, 0, MM * (height - 0.5 * g.rib_thickness_m)))


def _plate(g: TripodGeometry, robot: Robot) -> Manifold:
    outline = CrossSection.circle(MM * g.plate_radius_m, 2 * g.facets)
    arm = _rectangle(0.0, g.plate_arm_reach_m, -0.5 * g.plate_arm_width_m, 0.5 * g.plate_arm_width_m)
    for angle in robot.chamber_angle_deg:
        outline += arm.rotate(angle)
    return outline.extrude(MM * (g.plate_to_m - g.plate_from_m)).translate((0, 0, MM * g.plate_from_m))


def _as_surface(solid: Manifold) -> Surface:
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        raise MeshError(f"the solid of these measures cannot be built ({solid.status()}); check stage.geometry")
    return surface_of(solid)
