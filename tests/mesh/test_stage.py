import dataclasses

import meshio
import numpy as np
import pytest
from omegaconf import OmegaConf
from scipy.spatial import cKDTree

from softrl.artifacts.mesh import BASE, FREE, PLATE, Mesh
from softrl.core.config import build
from softrl.core.errors import ConfigError, MeshError
from softrl.core.tracking import NullTracker
from softrl.mesh.stage import run
from softrl.robots.robot import Robot
from tests.mesh.conftest import CONF, THREE, hollow

CM3 = 1e6


@pytest.fixture(scope="module")
def sample(configure, robot) -> Mesh:
    return run(configure(), robot, tracker=NullTracker())


def test_sample_is_the_robot(sample, configure, robot) -> None:
    tracker = NullTracker()
    run(configure(), robot, tracker=tracker)
    metrics = tracker.metrics
    assert 2000 < metrics["nodes_count"] < 3500
    assert metrics["volume_cm3"] == pytest.approx(435.0, rel=0.01)
    assert metrics["min_dihedral_deg"] > 6.0
    volumes = [metrics[f"cavity_{k}_volume_cm3"] for k in (1, 2, 3)]
    assert np.ptp(volumes) < 0.02 * np.mean(volumes)
    assert sample.chambers == 3


def test_sample_walls_are_nowhere_thin(sample) -> None:
    # the tetrahedraliser may move a surface within its envelope; a pierced or paper-thin wall must not pass
    solid_shell = _outside(sample)
    weights = np.random.default_rng(1).dirichlet([1.0, 1.0, 1.0], 30)
    cloud = np.einsum("sk,tkd->tsd", weights, sample.points[solid_shell]).reshape(-1, 3)
    wall = cKDTree(cloud).query(sample.points[np.unique(sample.cavity_triangles)])[0]
    assert wall.min() > 1.5e-3
    assert np.median(wall) == pytest.approx(3.8e-3, rel=0.1)


def _outside(mesh: Mesh) -> np.ndarray:
    faces = np.concatenate([mesh.tetrahedra[:, list(f)] for f in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))])
    inner = {tuple(t) for t in np.sort(mesh.cavity_triangles, axis=1).tolist()}
    key, first, uses = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    keep = [i for i, k in zip(first[uses == 1], key[uses == 1].tolist(), strict=True) if tuple(k) not in inner]
    return faces[keep]


def test_two_runs_agree_and_the_artifact_comes_back(sample, configure, robot, tmp_path) -> None:
    again = run(configure(), robot, tracker=NullTracker())
    sample.save(tmp_path / "mesh")
    loaded = Mesh.load(tmp_path / "mesh")
    for field in ("points", "tetrahedra", "node_region", "element_layer", "cavity_triangles", "cavity_of_triangle"):
        assert np.array_equal(getattr(sample, field), getattr(again, field)), field
        assert np.array_equal(getattr(sample, field), getattr(loaded, field)), field


def test_tiny_sample_is_smaller(configure, robot) -> None:
    tiny = run(configure(profile="tiny"), robot, tracker=NullTracker())
    assert len(tiny.points) < 1200
    assert set(np.unique(tiny.node_region).tolist()) == {0, 1, 2, 11, 12, 13}


def test_changed_measure_is_not_without_effect(configure, robot) -> None:
    with pytest.raises(ConfigError, match=r"stage\.geometry\.wall_m=0\.004.*made with 0\.0038.*source=generate"):
        run(configure("geometry.wall_m=0.004"), robot, tracker=NullTracker())


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"chamber_angle_deg": (90.0, -30.0, -150.0)}, r"angle_deg=\[90\.0, -30\.0, -150\.0\] where it has \[-90"),
        ({"chamber_angle_deg": (-87.0, -210.0, -330.0)}, r"robot\.chamber_angle_deg=\[-87\.0"),
        ({"chamber_angle_deg": (-90.0, -210.0)}, r"robot\.chamber_angle_deg"),
        ({"chamber_radius_m": 0.02}, r"another robot: robot\.chamber_radius_m=0\.02 where it has 0\.05;"),
        ({"length_m": 0.2}, r"another robot: robot\.length_m=0\.2 where it has 0\.1765;"),
    ],
)
def test_sample_of_another_robot_is_refused(configure, robot, changes, told) -> None:
    other = dataclasses.replace(robot, name="other", **changes)
    for profile in ("", "tiny"):
        with pytest.raises(ConfigError, match=f"{told}.*robot other, stage.source=<mesh>") as refused:
            run(configure(profile=profile), other, tracker=NullTracker())
        assert "\n" not in str(refused.value)


def test_the_shipped_segment_is_no_tripod(configure) -> None:
    node = OmegaConf.to_container(OmegaConf.load(CONF / "robot" / "three_chamber_segment.yaml"))
    with pytest.raises(ConfigError, match=r"chamber_angle_deg.*chamber_radius_m=0\.02 .*length_m=0\.1845 "):
        run(configure(), build(node, Robot, "robot"), tracker=NullTracker())


@pytest.mark.parametrize("axis", ["-z", "+x"])
def test_a_robot_along_another_axis_is_refused(configure, robot, axis) -> None:
    with pytest.raises(ConfigError, match=f"robot.axis=[{axis[0]}]{axis[1]}: stage=mesh needs"):
        run(configure(), dataclasses.replace(robot, axis=axis), tracker=NullTracker())


def test_the_samples_chambers_may_have_another_order(sample, configure, robot) -> None:
    renamed = dataclasses.replace(robot, chamber_angle_deg=(30.5, -90.0, 149.0))
    mesh = run(configure(), renamed, tracker=NullTracker())
    first = mesh.cavity_triangles[mesh.cavity_of_triangle == 1]
    assert np.array_equal(first, sample.cavity_triangles[sample.cavity_of_triangle == 0])


def test_own_volume_mesh_gives_the_same_artifact(sample, configure, robot, tmp_path) -> None:
    path = tmp_path / "own.vtu"
    meshio.write(path, meshio.Mesh(1e3 * sample.points, [("tetra", sample.tetrahedra)]))
    own = run(configure(f"source={path}"), robot, tracker=NullTracker())
    assert own.volume() == pytest.approx(sample.volume(), rel=1e-9)
    assert np.array_equal(own.node_region, sample.node_region)
    assert np.array_equal(own.cavity_of_triangle, sample.cavity_of_triangle)


def test_a_body_beside_the_z_axis_is_told(sample, configure, robot, tmp_path, caplog) -> None:
    path, other = tmp_path / "own.vtu", dataclasses.replace(robot, length_m=0.9 * robot.length_m)  # no tripod: ends, no ribs
    for aside, told in ((0.002, False), (0.03, True)):
        meshio.write(path, meshio.Mesh(sample.points + np.array([aside, 0.0, 0.0]), [("tetra", sample.tetrahedra)]))
        run(configure(f"source={path}", "unit_m=1.0"), other, tracker=NullTracker())
        assert ("expected it on the z axis" in caplog.text) == told


@pytest.mark.parametrize(
    ("turn", "shift", "told"),
    [((1, -1, -1), 0.0, r"from z = -1\d\d\.\d to -?0\.\d mm.*turn it over"),
     ((1, 1, 1), 0.3, r"from z = 300\.\d to 4\d\d\.\d mm.*move its base to z = 0")],
)  # fmt: skip
def test_a_body_that_does_not_stand_on_its_base_is_refused(sample, configure, robot, tmp_path, turn, shift, told) -> None:
    points = sample.points * np.array(turn) + np.array([0.0, 0.0, shift])
    meshio.write(tmp_path / "own.vtu", meshio.Mesh(points, [("tetra", sample.tetrahedra)]))
    with pytest.raises(MeshError, match=told):
        run(configure(f"source={tmp_path / 'own.vtu'}", "unit_m=1.0"), robot, tracker=NullTracker())


def test_filled_surface_is_refused_before_it_is_meshed(sample, configure, robot, tmp_path) -> None:
    path = tmp_path / "outside.stl"
    meshio.write(path, meshio.Mesh(1e3 * sample.points, [("triangle", _outside(sample))]))
    with pytest.raises(MeshError, match=r"outside\.stl has no cavity"):
        run(configure(f"source={path}"), robot, tracker=NullTracker())


def test_values_out_of_range(configure) -> None:
    for override, message in (
        ("unit_m=0", "unit_m=0 must be positive"),
        ("min_dihedral_deg=80", "min_dihedral_deg=80"),
        ("cavity_surfaces=[a.stl]", "brings its own cavities"),
    ):
        with pytest.raises(ConfigError, match=message):
            configure(override)


def test_an_envelope_wider_than_an_edge_is_refused(configure, robot) -> None:
    with pytest.raises(ConfigError, match="expected 0 < envelope < edge"):
        run(configure("tetrahedra.envelope_m=0.1"), robot, tracker=NullTracker())


@pytest.mark.slow
def test_sample_is_what_its_recipe_makes(sample, configure, robot, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    runs = [run(configure("source=generate"), robot, tracker=NullTracker()) for _ in range(3)]
    assert not list(tmp_path.iterdir()), "the tetrahedraliser left files in the working directory"
    for made in runs:
        # fTetWild is not deterministic: numbers of nodes vary by a few per cent
        assert len(made.points) == pytest.approx(len(sample.points), rel=0.15)
        assert made.volume() == pytest.approx(sample.volume(), rel=0.01)
        for chamber in range(3):
            assert made.cavity_volume(chamber) == pytest.approx(sample.cavity_volume(chamber), rel=0.03)
    regions = np.unique(sample.node_region)[1:]
    masks = [[mesh.node_region == region for region in regions] for mesh in (sample, *runs)]
    height = np.array([[mesh.points[m, 2].mean() for m in row] for mesh, row in zip((sample, *runs), masks, strict=True)])
    assert np.median(height[1:], axis=0) == pytest.approx(height[0], abs=1e-3)
    ribs = configure().regions_of(sample.points, robot)
    middle = 0.5 * (np.array(ribs.rib_from_m) + ribs.rib_to_m)
    assert np.abs(height[:, 2:] - middle).max() < 1e-3  # of every rib in every mesh
    assert np.abs(height[1:, :2] - height[0, :2]).max() < 1e-3
    count = np.array([[m.sum() for m in row] for row in masks])
    assert (count[1:] > 0.5 * count[0]).all() and (count[1:] < 2.5 * count[0]).all()
    # the nodes of a rib come in sixes, so that a few meshes tell of all ribs together and not of a single one
    count = np.c_[count[:, :2], count[:, 2:].sum(axis=1)]
    assert np.median(count[1:], axis=0) == pytest.approx(count[0], rel=0.25)
    assert count[1:] == pytest.approx(np.broadcast_to(count[0], count[1:].shape), rel=0.5)


@pytest.mark.slow
def test_a_surface_of_another_robot_needs_no_numbers(cubes, block, configure, robot, tmp_path) -> None:
    solid, path = cubes(hollow(block, *THREE)), tmp_path / "block.stl"
    meshio.write(path, meshio.Mesh(1e3 * solid.points, [("triangle", solid.boundary())]))
    mesh = run(configure(f"source={path}"), dataclasses.replace(robot, length_m=0.05), tracker=NullTracker())
    assert mesh.volume() == pytest.approx(solid.volume(), rel=0.01)
    assert [mesh.cavity_volume(k) for k in range(3)] == pytest.approx([3 * 0.01**3] * 3, rel=0.03)
    assert set(np.unique(mesh.node_region)) == {FREE, BASE, PLATE}
    assert mesh.points[mesh.node_region == BASE][:, 2].max() < 0.003
    assert mesh.points[mesh.node_region == PLATE][:, 2].min() > 0.047


@pytest.mark.slow
def test_surface_and_cavities_in_files_are_hollowed(sample, configure, robot, tmp_path) -> None:
    outside, cavities = tmp_path / "outside.stl", []
    meshio.write(outside, meshio.Mesh(1e3 * sample.points, [("triangle", _outside(sample))]))
    for chamber in range(3):
        cavities.append(str(tmp_path / f"cavity_{chamber}.stl"))
        # outward normals, as a program that draws single parts would write them
        triangles = sample.cavity_triangles[sample.cavity_of_triangle == chamber][:, ::-1]
        meshio.write(cavities[-1], meshio.Mesh(1e3 * sample.points, [("triangle", triangles)]))
    config = configure(f"source={outside}", f"cavity_surfaces=[{','.join(cavities)}]")
    made = run(config, robot, tracker=NullTracker())
    assert made.volume() == pytest.approx(sample.volume(), rel=0.02)
    assert made.cavity_volume(0) == pytest.approx(sample.cavity_volume(0), rel=0.05)


@pytest.mark.realdata
def test_filled_mesh_of_the_modelled_robot_is_refused(configure, robot, real_data) -> None:
    path = real_data / "paper_manipulator" / "ManipulatorWhole25.vtk"
    with pytest.raises(MeshError, match=r"no cavity.*680\.\d cm3.*filled"):
        run(configure(f"source={path}"), robot, tracker=NullTracker())


@pytest.mark.slow
@pytest.mark.realdata
def test_surface_of_the_modelled_robot_is_hollowed(configure, robot, real_data) -> None:
    path = real_data / "paper_manipulator" / "ManipulatorWhole25.stl"
    box = "regions.rib_box_m=[-0.0325,-0.036,0.0325,0.024]"
    mesh = run(configure(f"source={path}", box, "regions.rib_radius_m=0.05"), robot, tracker=NullTracker())
    assert CM3 * mesh.volume() == pytest.approx(435.3, rel=0.02)
    assert [CM3 * mesh.cavity_volume(k) for k in range(3)] == pytest.approx([81.8] * 3, rel=0.05)
    assert set(np.unique(mesh.node_region).tolist()) == {0, 1, 2, *range(11, 17)}
