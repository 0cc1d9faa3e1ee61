from pathlib import Path

import meshio
import numpy as np
import pytest

from softrl.core.errors import MeshError
from softrl.mesh.cavity import find_cavities
from softrl.mesh.quality import check_orientation
from softrl.mesh.reader import join_surfaces, read_mesh, read_surface
from softrl.mesh.surface import Surface
from softrl.mesh.tetrahedra import Tetrahedra
from tests.mesh.conftest import THREE, hollow


@pytest.fixture
def body(cubes, block) -> Tetrahedra:
    # as high as the robot, so that the unit is plausible
    return cubes(hollow(block, *THREE), edge=0.0353)


def write(path: Path, points: np.ndarray, **cells: np.ndarray) -> Path:
    meshio.write(path, meshio.Mesh(points, list(cells.items())))
    return path


@pytest.mark.parametrize("ending", ["vtk", "vtu", "msh", "inp"])
def test_volume_mesh_in_any_format_and_unit(tmp_path, body, robot, ending) -> None:
    path = write(tmp_path / f"body.{ending}", 1e3 * body.points, tetra=body.corners)
    read = read_mesh(path, 0.001, robot)
    assert isinstance(read, Tetrahedra)
    assert read.volume() == pytest.approx(body.volume(), rel=1e-6)
    assert len(find_cavities(read, robot, path.name).triangles) == len(find_cavities(body, robot, "body").triangles)


@pytest.mark.parametrize("ending", ["stl", "ply", "obj", "vtu"])
def test_surface_in_any_format_keeps_its_cavities(tmp_path, body, robot, ending) -> None:
    path = write(tmp_path / f"body.{ending}", 1e3 * body.points, triangle=body.boundary())
    read = read_mesh(path, 0.001, robot)
    assert isinstance(read, Surface)
    assert read.volume() == pytest.approx(body.volume(), rel=1e-4)


def test_order_of_corners_is_a_convention_but_one_inverted_element_is_not(tmp_path, body, robot) -> None:
    all_turned = body.corners[:, [0, 2, 1, 3]]
    read = read_mesh(write(tmp_path / "turned.vtu", body.points, tetra=all_turned), 1.0, robot)
    assert read.volume() == pytest.approx(body.volume(), rel=1e-9)
    one = body.corners.copy()
    one[7] = one[7, [0, 2, 1, 3]]
    path = write(tmp_path / "one.vtu", body.points, tetra=one)
    with pytest.raises(MeshError, match="1 inverted or flat of 3576"):
        check_orientation(read_mesh(path, 1.0, robot), "one.vtu")


def test_quadratic_elements_give_their_corners(tmp_path, body, robot) -> None:
    edges = body.corners[:, [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]]]
    middle = body.points[edges].mean(axis=2).reshape(-1, 3)
    number = len(body.points) + np.arange(len(middle)).reshape(-1, 6)
    path = write(tmp_path / "t10.vtu", np.vstack([body.points, middle]), tetra10=np.hstack([body.corners, number]))
    read = read_mesh(path, 1.0, robot)
    assert len(read.points) == len(body.points)
    assert read.volume() == pytest.approx(body.volume(), rel=1e-9)


def test_elements_of_another_kind_are_refused_and_not_left_out_as_a_cavity(tmp_path, cubes, block, robot) -> None:
    solid = cubes(block, edge=0.0353)
    bits = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    corners = 0.0353 * (bits + np.array([-0.5, -0.5, 2.0]))
    hexahedron = np.linalg.norm(solid.points[None] - corners[:, None], axis=2).argmin(axis=1)[None]
    inside = (np.abs(solid.points[solid.corners].mean(axis=1) - corners.mean(axis=0)) < 0.5 * 0.0353).all(axis=1)
    assert inside.sum() == 6
    path = write(tmp_path / "mixed.vtu", solid.points, tetra=solid.corners[~inside], hexahedron=hexahedron)
    with pytest.raises(MeshError, match=r"mixed\.vtu holds hexahedron beside tetra; expected tetra alone"):
        read_mesh(path, 1.0, robot)
    path = write(tmp_path / "boundary.vtu", solid.points, tetra=solid.corners, quad=hexahedron[:, :4])
    assert isinstance(read_mesh(path, 1.0, robot), Tetrahedra)  # a face of a volume mesh is no element of it
    path = write(tmp_path / "faces.vtu", solid.points, triangle=solid.boundary(), quad=hexahedron[:, :4])
    with pytest.raises(MeshError, match="holds quad beside triangle"):
        read_mesh(path, 1.0, robot)


def test_wrong_unit_is_told_with_the_right_one(tmp_path, body, robot) -> None:
    path = write(tmp_path / "mm.vtu", 1e3 * body.points, tetra=body.corners)
    with pytest.raises(MeshError, match=r"176\.5 m high with stage\.unit_m=1.*set stage\.unit_m=0\.001 \(mm\)"):
        read_mesh(path, 1.0, robot)


def test_open_surface_is_refused(tmp_path, body, robot) -> None:
    path = write(tmp_path / "open.stl", body.points, triangle=body.boundary()[1:])
    with pytest.raises(MeshError, match=r"open\.stl is open: 3 edges"):
        read_mesh(path, 1.0, robot)


def test_cavities_may_come_in_files_of_their_own(tmp_path, cubes, block, body, robot) -> None:
    outer = cubes(block, edge=0.0353)
    cavities = find_cavities(body, robot, "body")
    parts = []
    for chamber in range(3):
        path = tmp_path / f"cavity{chamber}.stl"
        write(path, 1e3 * body.points, triangle=cavities.triangles[cavities.chamber == chamber])
        parts.append(read_surface(path, 0.001))
    joined = join_surfaces(Surface(outer.points, outer.boundary()), parts)
    assert joined.volume() == pytest.approx(body.volume(), rel=1e-5)


def test_files_that_hold_no_mesh(tmp_path, body, robot, capsys) -> None:
    with pytest.raises(MeshError, match=r"none\.vtk does not exist"):
        read_mesh(tmp_path / "none.vtk", 1.0, robot)
    rubbish = tmp_path / "rubbish.vtk"
    rubbish.write_text("no mesh\n")
    with pytest.raises(MeshError, match="cannot be read as a mesh"):
        read_mesh(rubbish, 1.0, robot)
    unknown = tmp_path / "body.docx"
    unknown.write_text("no mesh\n")
    with pytest.raises(MeshError, match="cannot be read as a mesh"):
        read_mesh(unknown, 1.0, robot)
    lines = write(tmp_path / "lines.vtu", body.points, line=body.corners[:, :2])
    with pytest.raises(MeshError, match=r"no tetrahedra and no triangles \(line\)"):
        read_mesh(lines, 1.0, robot)
