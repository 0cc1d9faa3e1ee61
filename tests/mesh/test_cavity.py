import dataclasses

import numpy as np
import pytest

from softrl.artifacts.mesh import tetrahedron_volumes
from softrl.core.errors import MeshError
from softrl.mesh.cavity import cavities_of, find_cavities
from softrl.mesh.surface import Surface, enclosed_volume
from tests.mesh.conftest import THREE, hollow

CELL = 1e-6  # m^3 of a cube of 10 mm


def test_three_cavities_in_the_order_of_the_chambers(cubes, block, robot) -> None:
    solid = cubes(hollow(block, *THREE))
    cavities = find_cavities(solid, robot, "block")
    for chamber, angle in enumerate(robot.chamber_angle_deg):
        triangles = cavities.triangles[cavities.chamber == chamber]
        # normals point into the cavity: its volume is negative, three cells of it
        assert enclosed_volume(solid.points, triangles) == pytest.approx(-3 * CELL, rel=1e-9)
        centre = solid.points[np.unique(triangles)].mean(axis=0)
        apart = np.rad2deg(np.arctan2(centre[1], centre[0])) - angle
        assert abs((apart + 180) % 360 - 180) < 15


def test_order_follows_the_robot(cubes, block, robot) -> None:
    solid = cubes(hollow(block, *THREE))
    turned = dataclasses.replace(robot, chamber_angle_deg=(30.0, -90.0, 150.0))
    a, b = find_cavities(solid, robot, "block"), find_cavities(solid, turned, "block")
    first = b.triangles[b.chamber == 1]
    assert np.array_equal(np.sort(first, axis=0), np.sort(a.triangles[a.chamber == 0], axis=0))


def test_boundary_and_elements_agree_on_the_volume(cubes, block) -> None:
    solid = cubes(hollow(block, *THREE))
    assert enclosed_volume(solid.points, solid.boundary()) == pytest.approx(solid.volume(), rel=1e-9)
    assert solid.volume() == pytest.approx((11 * 11 * 5 - 9) * CELL, rel=1e-9)
    assert (tetrahedron_volumes(solid.points, solid.corners) > 0).all()


def test_filled_chambers_are_refused(cubes, block, robot) -> None:
    with pytest.raises(MeshError, match=r"block\.vtk has no cavity.*605\.0 cm3.*3 chambers are filled"):
        find_cavities(cubes(block), robot, "block.vtk")


def test_wrong_number_of_cavities_is_named(cubes, block, robot) -> None:
    with pytest.raises(MeshError, match=r"2 cavities \(3\.00, 3\.00 cm3\).*3 chambers"):
        find_cavities(cubes(hollow(block, *THREE[:2])), robot, "block")


def test_cavity_open_to_the_outside_does_not_count(cubes, block, robot) -> None:
    cells = hollow(block, *THREE)
    cells[5, 1, 4] = False
    with pytest.raises(MeshError, match=r"2 cavities.*open to the outside is no cavity"):
        find_cavities(cubes(cells), robot, "block")


def test_cavity_that_touches_the_outside_is_refused(cubes, block, robot) -> None:
    along_edge = hollow(block, *THREE)
    along_edge[4, 0, 2] = False  # a dent whose vertical edge is one of the cavity's
    with pytest.raises(MeshError, match="touches the outside or another cavity in 2 nodes"):
        find_cavities(cubes(along_edge), robot, "block")
    in_a_point = hollow(block, *THREE)
    in_a_point[4, 0, 4] = False  # a dent whose corner is one of the cavity's
    with pytest.raises(MeshError, match="touches the outside or another cavity in 1 nodes"):
        find_cavities(cubes(in_a_point), robot, "block")


def test_cavities_at_other_angles_are_refused(cubes, block, robot) -> None:
    with pytest.raises(MeshError, match=r"cavities at .* deg around z.*-90, -210, -330 deg"):
        find_cavities(cubes(hollow(block, (5, 9), (2, 3), (8, 3))), robot, "block")


def test_cavities_beside_their_chambers_are_told(cubes, block, robot, caplog) -> None:
    solid = cubes(hollow(block, *THREE))
    find_cavities(solid, robot, "block")  # up to 4 deg off
    assert not caplog.records
    find_cavities(solid, dataclasses.replace(robot, chamber_angle_deg=(-84.0, -210.0, -330.0)), "block")
    (told,) = caplog.messages
    assert "block has its cavities at" in told and "up to 6 deg from the chambers of robot tripod" in told


def test_the_side_of_a_single_cavity_is_compared(cubes, block, robot, caplog) -> None:
    def find(cell: tuple[int, int], angle_deg: float) -> None:
        find_cavities(cubes(hollow(block, cell)), dataclasses.replace(robot, chamber_angle_deg=(angle_deg,)), "finger")

    find((8, 5), 3.0)  # at 0 deg
    find((5, 5), 180.0)  # in the middle
    assert not caplog.records
    find((8, 5), 40.0)
    assert "finger has its cavity at 0 deg around z, but robot tripod has its chamber at 40 deg" in caplog.text
    with pytest.raises(MeshError, match=r"cavity at 0 deg around z, .* chamber at 180 deg; turn the mesh"):
        find((8, 5), 180.0)


def test_a_cavity_is_where_its_volume_is_and_not_its_nodes(cubes, block, robot, caplog) -> None:
    # a cavity in the middle, one of whose triangles is cut into many: it still lies on no side
    solid = cubes(hollow(block, (5, 5)))
    points, triangles = solid.points, solid.boundary()
    own = np.isclose(points[triangles][:, :, 0], 0.005).all(axis=1) & (np.abs(points[triangles][:, :, 1]) < 0.006).all(axis=1)
    for _ in range(300):
        at = np.flatnonzero(own)[0]
        corners, apex = triangles[at], len(points)
        points = np.vstack([points, points[corners].mean(axis=0)])
        cut = np.array([[*pair, apex] for pair in zip(corners, np.roll(corners, -1), strict=True)])
        triangles, own = np.vstack([np.delete(triangles, at, axis=0), cut]), np.r_[np.delete(own, at), [True] * 3]
    one = dataclasses.replace(robot, chamber_angle_deg=(180.0,))
    assert len(cavities_of(Surface(points, triangles), one, "finger").triangles) > 600
    assert not caplog.records


def test_two_bodies_are_refused(cubes, block, robot) -> None:
    cells = hollow(block, *THREE)
    cells[:, 4, :] = False
    with pytest.raises(MeshError, match="2 separate solids"):
        find_cavities(cubes(cells), robot, "block")
