import dataclasses

import numpy as np
import pytest

from softrl.artifacts.mesh import BASE, FIRST_RIB, PLATE
from softrl.core.errors import ConfigError, MeshError
from softrl.core.tracking import NullTracker
from softrl.mesh.geometry import build_tripod
from softrl.mesh.region import tag_nodes
from softrl.mesh.stage import run

OWN = "source=body.stl"  # a file of the user's, which is not read here


@pytest.fixture(scope="module")
def mesh(configure, robot):
    return run(configure(), robot, tracker=NullTracker())


@pytest.fixture(scope="module")
def regions(mesh, configure, robot):
    return configure().regions_of(mesh.points, robot)


def test_each_rib_is_one_flat_part_between_all_bellows(mesh, regions) -> None:
    for i, (low, high) in enumerate(zip(regions.rib_from_m, regions.rib_to_m, strict=True)):
        points = mesh.points[mesh.node_region == FIRST_RIB + i]
        assert points[:, 2].min() > low - regions.tolerance_m
        assert points[:, 2].max() < high + regions.tolerance_m
        # centred on the axis, and as wide towards each of the three bellows
        assert np.abs(points[:, :2].mean(axis=0)).max() < 5e-3
        for angle in np.deg2rad([-90.0, 150.0, 30.0]):
            assert (points[:, :2] @ [np.cos(angle), np.sin(angle)]).max() > 0.025


def test_whole_ribs_are_tagged(mesh, regions) -> None:
    # an element well inside a rib's prism has four nodes of that rib: no soft remainder in a stiff part
    centre = mesh.points[mesh.tetrahedra].mean(axis=1)
    within = np.hypot(centre[:, 0], centre[:, 1]) < 0.020
    for i, (low, high) in enumerate(zip(regions.rib_from_m, regions.rib_to_m, strict=True)):
        elements = mesh.tetrahedra[within & (centre[:, 2] > low) & (centre[:, 2] < high)]
        assert len(elements) > 10
        assert (mesh.node_region[elements] == FIRST_RIB + i).all()


def test_base_and_plate(mesh) -> None:
    assert mesh.points[mesh.node_region == BASE][:, 2].max() < 0.007
    plate = mesh.points[mesh.node_region == PLATE]
    assert plate[:, 2].min() > 0.169
    assert np.hypot(plate[:, 0], plate[:, 1]).max() > 0.08


def test_layers_count_upward(mesh) -> None:
    centre = mesh.points[mesh.tetrahedra, 2].mean(axis=1)
    assert set(mesh.element_layer.tolist()) == set(range(7))
    for layer in range(6):
        assert centre[mesh.element_layer == layer].max() <= centre[mesh.element_layer == layer + 1].min()


def test_box_narrows_the_ribs(mesh, regions) -> None:
    regions = dataclasses.replace(regions, rib_box_m=(-0.1, 0.0, 0.1, 0.1))
    ribs = tag_nodes(mesh.points, regions, "sample") >= FIRST_RIB
    assert mesh.points[ribs, 1].min() >= -regions.tolerance_m
    assert 0 < ribs.sum() < (mesh.node_region >= FIRST_RIB).sum()


def test_region_without_nodes_is_an_error(mesh, regions) -> None:
    regions = dataclasses.replace(regions, plate_from_m=0.2, plate_to_m=0.3)
    with pytest.raises(MeshError, match=r"0 nodes in the region of stage\.regions\.plate_from_m.*17\d\.\d mm"):
        tag_nodes(mesh.points, regions, "sample")


def test_planes_must_rise(configure, robot) -> None:
    with pytest.raises(ConfigError, match="expected them rising"):
        run(configure("regions.base_below_m=0.03"), robot, tracker=NullTracker())
    with pytest.raises(ConfigError, match="expected pairs"):
        run(configure("regions.rib_from_m=[0.02]"), robot, tracker=NullTracker())


def test_of_the_tripod_regions_are_where_its_measures_put_them(regions) -> None:
    assert (regions.base_below_m, regions.plate_from_m, regions.plate_to_m) == (0.005, 0.1715, 0.1765)
    assert np.allclose(regions.rib_from_m, 0.02275 + 0.025 * np.arange(6))
    assert np.allclose(np.subtract(regions.rib_to_m, regions.rib_from_m), 0.005)


@pytest.mark.parametrize(
    ("changed", "measure"), [({"chamber_angle_deg": (0.0, 90.0, 180.0, 270.0)}, ""), ({}, "geometry.plate_to_m=0.18")]
)
def test_what_is_generated_has_the_ribs_of_its_measures_whatever_the_robot(configure, robot, changed, measure) -> None:
    config = configure("source=generate", *filter(None, [measure]))
    made = dataclasses.replace(robot, **changed)
    found = config.regions_of(build_tripod(config.geometry, made).points, made)
    assert len(found.rib_from_m) == config.geometry.bulges
    assert (found.base_below_m, found.plate_to_m) == (config.geometry.foot_height_m, config.geometry.plate_to_m)


@pytest.mark.parametrize("height", [0.3, 0.1, 0.005])
def test_the_ends_are_rigid_alike_whatever_the_size(configure, robot, height) -> None:
    z = np.repeat(np.linspace(0.0, height, 101), 3)
    points = np.stack([np.zeros_like(z), np.zeros_like(z), z], axis=1)
    other = dataclasses.replace(robot, length_m=height)
    region = tag_nodes(points, configure(OWN).regions_of(points, other), "body")
    assert [(region == part).sum() for part in (BASE, PLATE)] == [3 * 4, 3 * 4]  # up to three of a hundred steps
    told = configure(OWN, "regions.tolerance_m=0.0").regions_of(points, other)
    assert told.tolerance_m == 0.0


def test_of_another_robot_the_ends_are_rigid_unless_something_is_said(configure, robot) -> None:
    other, points = dataclasses.replace(robot, length_m=0.12), np.array([[0.0, 0.0, -0.01], [0.0, 0.0, 0.11]])
    found = configure(OWN).regions_of(points, other)
    assert np.allclose((found.base_below_m, found.plate_from_m, found.plate_to_m), (-0.0076, 0.1076, 0.11))
    assert found.rib_from_m == ()
    ribs = "regions.rib_from_m=[0.05]", "regions.rib_to_m=[0.06]"
    found = configure(OWN, "regions.plate_from_m=0.1", *ribs, "regions.rib_radius_m=0.07").regions_of(points, other)
    assert (found.plate_from_m, found.rib_from_m, found.rib_to_m) == (0.1, (0.05,), (0.06,))
    assert found.rib_radius_m == 0.07
    with pytest.raises(ConfigError, match="expected rib_radius_m or rib_box_m"):  # the tripod's would cut them off
        configure(OWN, *ribs).regions_of(points, other)
    boxed = configure(OWN, *ribs, "regions.rib_box_m=[-0.1,-0.1,0.1,0.1]").regions_of(points, other)
    wide = np.array([[0.09, y, z] for y in (-0.09, 0.0, 0.09) for z in (-0.01, 0.055, 0.11)])
    assert (tag_nodes(wide, boxed, "body") == FIRST_RIB).sum() == 3
