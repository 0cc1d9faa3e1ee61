"""Which nodes are clamped or move as a rigid part, and which layer an element belongs to."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from softrl.artifacts.mesh import BASE, FIRST_RIB, FREE, PLATE
from softrl.core.errors import ConfigError, MeshError
from softrl.mesh.geometry import TripodGeometry

ENDS = 0.02  # of a body's height: so much of either end is rigid where nobody says otherwise
# how far outside a region its nodes may lie, where nobody says otherwise: of the tripod, and as a share of such an end
NEAR_M, NEAR_SHARE = 1e-3, 0.5
RIB_RADIUS_M = 0.033  # of the tripod: up to where its ribs become bellows


@dataclass(frozen=True)
class Regions:
    """Where base, plate and ribs are, by planes across the z axis.

    Attributes
    ----------
    base_below_m : nodes at or below this height are clamped
    plate_from_m, plate_to_m : heights of the rigid top plate
    rib_from_m, rib_to_m : heights of the rigid ribs, from below; empty for a robot without ribs
    rib_radius_m : a rib reaches so far from the z axis
    rib_box_m : x_min, y_min, x_max, y_max of the ribs, or null when their radius is enough
    tolerance_m : a node this far outside still counts, because a tetrahedraliser moves faces a little
    """

    base_below_m: float
    plate_from_m: float
    plate_to_m: float
    rib_from_m: tuple[float, ...]
    rib_to_m: tuple[float, ...]
    rib_radius_m: float
    rib_box_m: tuple[float, float, float, float] | None
    tolerance_m: float

    def __post_init__(self) -> None:
        if len(self.rib_from_m) != len(self.rib_to_m):
            raise ConfigError(
                f"stage.regions has {len(self.rib_from_m)} rib_from_m but {len(self.rib_to_m)} rib_to_m; expected pairs"
            )
        heights = [self.base_below_m]
        for low, high in zip(self.rib_from_m, self.rib_to_m, strict=True):
            heights += [low, high]
        heights += [self.plate_from_m, self.plate_to_m]
        if any(a >= b for a, b in pairwise(heights)):
            raise ConfigError(
                f"stage.regions: base, ribs from below and plate are at {heights} m; expected them rising"
            )
        if self.tolerance_m < 0 or self.rib_radius_m <= 0:
            raise ConfigError(
                f"stage.regions.tolerance_m={self.tolerance_m:g}, rib_radius_m={self.rib_radius_m:g}; "
                "expected 0 or more, and a positive radius"
            )


@dataclass(frozen=True)
class RegionSettings:
    """What is said about ``Regions``; null where it is left to the body at hand."""

    base_below_m: float | None
    plate_from_m: float | None
    plate_to_m: float | None
    rib_from_m: tuple[float, ...] | None
    rib_to_m: tuple[float, ...] | None
    rib_radius_m: float | None
    rib_box_m: tuple[float, float, float, float] | None
    tolerance_m: float | None

    def of_tripod(self, geometry: TripodGeometry) -> Regions:
        """Return the regions, of the tripod where nothing is said: its feet, its plate and its ribs."""
        g, half = geometry, 0.5 * geometry.rib_thickness_m
        below, above = (tuple(float(h) for h in g.bulge_height + side) for side in (-half, half))
        reach = RIB_RADIUS_M if self.rib_radius_m is None else self.rib_radius_m
        return self._or(g.foot_height_m, (g.plate_from_m, g.plate_to_m), (below, above), reach, NEAR_M)

    def of_ends(self, points: np.ndarray) -> Regions:
        """Return the regions, where nothing is said the ends of a body with ``points`` (nodes, 3) m, and no ribs."""
        low, high = float(points[:, 2].min()), float(points[:, 2].max())
        end, reach = ENDS * (high - low), self.rib_radius_m
        if self.rib_from_m and reach is None and self.rib_box_m is None:
            raise ConfigError("stage.regions.rib_from_m names ribs; expected rib_radius_m or rib_box_m, too: how far they reach")
        return self._or(low + end, (high - end, high), ((), ()), np.inf if reach is None else reach, NEAR_SHARE * end)

    def _or(
        self, base: float, plate: tuple[float, float], ribs: tuple[tuple[float, ...], tuple[float, ...]], reach: float,
        tolerance: float,
    ) -> Regions:
        found = (self.base_below_m, self.plate_from_m, self.plate_to_m, self.rib_from_m, self.rib_to_m)
        places = [b if a is None else a for a, b in zip(found, (base, *plate, *ribs), strict=True)]
        near = tolerance if self.tolerance_m is None else self.tolerance_m
        return Regions(*places, reach, self.rib_box_m, near)


def tag_nodes(points: np.ndarray, regions: Regions, name: str) -> np.ndarray:
    """Return the region (nodes,) of ``points`` (nodes, 3) m, numbered as in ``artifacts.mesh``.

    Raises
    ------
    MeshError
        If a region holds fewer than three nodes: then it is no rigid body.
    """
    r, z = regions, points[:, 2]
    region = np.full(len(points), FREE)
    wide = _within_rib_outline(points, r)
    for i, (low, high) in enumerate(zip(r.rib_from_m, r.rib_to_m, strict=True)):
        region[wide & _between(z, low, high, r.tolerance_m)] = FIRST_RIB + i
    region[_between(z, r.plate_from_m, r.plate_to_m, r.tolerance_m)] = PLATE
    region[z <= r.base_below_m + r.tolerance_m] = BASE
    for number, key in _names(r).items():
        count = int((region == number).sum())
        if count < 3:
            low, high = 1e3 * z.min(), 1e3 * z.max()
            raise MeshError(
                f"{name} has {count} nodes in the region of stage.regions.{key}; expected 3 or more "
                f"(the mesh reaches from z = {low:.1f} to {high:.1f} mm)"
            )
    return region


def layer_of_elements(points: np.ndarray, corners: np.ndarray, regions: Regions) -> np.ndarray:
    """Return the layer (elements,): 0 with its centroid below the middle of the first rib, then counted upward."""
    middle = 0.5 * (np.array(regions.rib_from_m) + np.array(regions.rib_to_m))
    return np.searchsorted(middle, points[corners, 2].mean(axis=1))


def _between(z: np.ndarray, low: float, high: float, tolerance: float) -> np.ndarray:
    return (z >= low - tolerance) & (z <= high + tolerance)


def _within_rib_outline(points: np.ndarray, r: Regions) -> np.ndarray:
    inside = np.hypot(points[:, 0], points[:, 1]) <= r.rib_radius_m + r.tolerance_m
    if r.rib_box_m is not None:
        low, high = np.array(r.rib_box_m[:2]), np.array(r.rib_box_m[2:])
        inside &= ((points[:, :2] >= low - r.tolerance_m) & (points[:, :2] <= high + r.tolerance_m)).all(axis=1)
    return inside


def _names(r: Regions) -> dict[int, str]:
    names = {BASE: "base_below_m", PLATE: "plate_from_m .. plate_to_m"}
    return names | {FIRST_RIB + i: f"rib_from_m[{i}] .. rib_to_m[{i}]" for i in range(len(r.rib_from_m))}
