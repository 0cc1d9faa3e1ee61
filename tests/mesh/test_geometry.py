import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from softrl.core.errors import ConfigError, MeshError
from softrl.mesh.cavity import cavities_of
from softrl.mesh.geometry import build_tripod
from softrl.mesh.surface import check_closed, enclosed_volume, label_shells

CM3 = 1e6


def shell_volumes(surface):
    shell = label_shells(surface.triangles)
    return np.array([enclosed_volume(surface.points, surface.triangles[shell == k]) for k in range(shell.max() + 1)])


def test_default_tripod_has_the_volume_of_the_modelled_robot(configure, robot) -> None:
    # the robot it follows: 435 cm3 of solid, cavities of 82 cm3, 176.5 mm high, arms that reach 80.3 mm along x
    surface = build_tripod(configure().geometry, robot)
    check_closed(surface.triangles, surface.points, "tripod")
    assert CM3 * surface.volume() == pytest.approx(435.0, rel=0.02)
    volumes = shell_volumes(surface)
    assert (volumes > 0).sum() == 1
    assert -CM3 * volumes[volumes < 0] == pytest.approx([82.0] * 3, rel=0.1)
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    assert low == pytest.approx([-0.0803, -0.0783, 0.0], abs=1e-4)
    assert high == pytest.approx([0.0803, 0.0608, 0.1765], abs=1e-4)


def test_surface_has_the_symmetry_of_the_chambers(configure, robot) -> None:
    points = build_tripod(configure().geometry, robot).points
    c, s = np.cos(2 * np.pi / 3), np.sin(2 * np.pi / 3)
    turned = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    # only where the solid modeller drops a collinear point may one side lack it
    distance = cKDTree(points).query(turned)[0]
    assert np.quantile(distance, 0.97) < 2e-6


def test_cavities_end_where_they_should_and_are_equal(configure, robot) -> None:
    geometry = configure().geometry
    surface = build_tripod(geometry, robot)
    cavities = cavities_of(surface, robot, "tripod")
    volumes = []
    for chamber in range(3):
        triangles = cavities.triangles[cavities.chamber == chamber]
        z = surface.points[triangles, 2]
        assert (z.min(), z.max()) == pytest.approx((geometry.cavity_from_m, geometry.cavity_to_m), abs=1e-6)
        volumes.append(enclosed_volume(surface.points, triangles))
    assert np.ptp(volumes) < 1e-3 * abs(np.mean(volumes))


def test_volume_hardly_depends_on_the_facets(configure, robot) -> None:
    geometry = configure().geometry
    volumes = [build_tripod(dataclasses.replace(geometry, facets=n), robot).volume() for n in (8, 16, 32)]
    assert volumes == pytest.approx([volumes[-1]] * 3, rel=5e-3)


def test_thicker_wall_takes_from_the_cavity_what_it_gives_to_the_solid(configure, robot) -> None:
    geometry = configure().geometry
    thin, thick = (build_tripod(dataclasses.replace(geometry, wall_m=w), robot) for w in (0.003, 0.0045))
    gain = thick.volume() - thin.volume()
    lost = (-shell_volumes(thin).clip(max=0).sum()) - (-shell_volumes(thick).clip(max=0).sum())
    assert gain > 0
    assert gain == pytest.approx(lost, rel=1e-4)


def test_other_numbers_of_chambers(configure, robot) -> None:
    four = dataclasses.replace(robot, chamber_angle_deg=(0.0, 90.0, 180.0, 270.0))
    surface = build_tripod(configure().geometry, four)
    assert (shell_volumes(surface) < 0).sum() == 4
    assert cavities_of(surface, four, "four").chamber.max() == 3


@pytest.mark.parametrize("angles", [(0.0,), (0.0, 180.0)])
def test_fewer_chambers_than_a_rib_has_corners_are_refused(configure, robot, angles) -> None:
    with pytest.raises(ConfigError, match=f"of 3 chambers or more; robot tripod has {len(angles)}"):
        build_tripod(configure().geometry, dataclasses.replace(robot, chamber_angle_deg=angles))


def test_ribs_that_reach_no_bellows_are_noticed(configure, robot) -> None:
    surface = build_tripod(configure("geometry.rib_inradius_m=0.01").geometry, robot)
    with pytest.raises(MeshError, match="7 separate solids"):
        cavities_of(surface, robot, "tripod")


def test_impossible_measures_are_refused(configure) -> None:
    for override, message in (
        ("geometry.wall_m=0.013", "wall_m=0.013.*rising"),
        ("geometry.neck_radius_m=-1", "neck_radius_m=-1 must be positive"),
        ("geometry.cavity_to_m=0.16", "expected them rising"),
        ("geometry.facets=3", "facets=3"),
    ):
        with pytest.raises(ConfigError, match=message):
            configure(override)
