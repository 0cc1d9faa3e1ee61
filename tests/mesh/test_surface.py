import numpy as np
import pytest

from softrl.core.errors import MeshError
from softrl.mesh.reader import join_surfaces
from softrl.mesh.surface import (
    Surface,
    centroid,
    check_closed,
    enclosed_volume,
    label_shells,
    merge_points,
    orient_shells,
    winding_number,
)
from softrl.mesh.tetrahedra import Tetrahedra, TetrahedraWanted, tidy

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])


def tetrahedron(scale: float = 1.0, shift: float = 0.0) -> Surface:
    solid = Tetrahedra(scale * (CORNERS - 0.25) + shift, np.array([[0, 1, 2, 3]]))
    return Surface(solid.points, solid.boundary())


def flipped(surface: Surface) -> Surface:
    return Surface(surface.points, surface.triangles[:, ::-1])


def test_enclosed_volume_is_that_of_the_solid_wherever_it_stands() -> None:
    assert enclosed_volume(CORNERS, tetrahedron().triangles) == pytest.approx(1 / 6, rel=1e-12)
    assert tetrahedron(2.0, shift=1e4).volume() == pytest.approx(8 / 6, rel=1e-9)
    assert flipped(tetrahedron()).volume() == pytest.approx(-1 / 6, rel=1e-12)


def test_the_centroid_is_that_of_the_volume_wherever_the_surface_is_finer() -> None:
    surface = tetrahedron(2.0, shift=3.0)
    assert centroid(surface.points, surface.triangles) == pytest.approx([3.0] * 3, rel=1e-12)
    for _ in range(4):  # one corner's triangles cut into three, again and again
        first, middle = surface.triangles[0], surface.points[surface.triangles[0]].mean(axis=0)
        cut = np.array([[*pair, len(surface.points)] for pair in zip(first, np.roll(first, -1), strict=True)])
        surface = Surface(np.vstack([surface.points, middle]), np.vstack([cut, surface.triangles[1:]]))
    assert surface.volume() == pytest.approx(8 / 6, rel=1e-12)
    assert np.abs(surface.points.mean(axis=0) - 3.0).max() > 0.05
    assert centroid(surface.points, surface.triangles[:, ::-1]) == pytest.approx([3.0] * 3, rel=1e-12)


def test_the_wall_of_a_thin_plate_is_its_thickness(cubes) -> None:
    plate = cubes(np.ones((30, 30, 1), bool), 0.01)
    wall = Surface(plate.points, plate.boundary()).wall()
    assert wall == pytest.approx(0.01 / (1.0 + 2.0 / 30.0))  # its rim is area, too


def test_the_envelope_of_an_edge_that_was_told_is_a_tenth_of_it(cubes) -> None:
    body = cubes(np.ones((10, 10, 10), bool), 0.01)
    surface = Surface(body.points, body.boundary())
    for told, edge, envelope in ((None, 0.1 / 7.0, 0.01 / 7.0), (0.001, 0.001, 1e-4), (0.05, 0.05, 0.125 * surface.wall())):
        made = TetrahedraWanted(told, None, 10.0).of_walls(surface)
        assert (made.edge_m, made.envelope_m) == pytest.approx((edge, envelope))


def test_winding_number_tells_inside_from_outside() -> None:
    surface = tetrahedron()
    query = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [-0.2, -0.2, -0.2], [-0.3, 0.0, 0.0]])
    assert winding_number(query, surface.points, surface.triangles) == pytest.approx([1, 0, 1, 0], abs=1e-12)


@pytest.mark.parametrize("turn_outer", [False, True])
@pytest.mark.parametrize("turn_inner", [False, True])
def test_nesting_decides_which_shell_is_a_cavity(turn_outer: bool, turn_inner: bool) -> None:
    outer, inner, island = tetrahedron(4.0), tetrahedron(2.0), tetrahedron(1.0)
    given = [flipped(outer) if turn_outer else outer, flipped(inner) if turn_inner else inner, island]
    joined = join_surfaces(given[0], given[1:])
    assert joined.volume() == pytest.approx((64 - 8 + 1) / 6, rel=1e-12)
    shells = label_shells(joined.triangles)
    signs = [np.sign(enclosed_volume(joined.points, joined.triangles[shells == k])) for k in range(3)]
    assert signs == [1, -1, 1]
    assert orient_shells(joined).triangles == pytest.approx(joined.triangles)


def test_missing_triangle_is_an_open_surface() -> None:
    surface = tetrahedron()
    with pytest.raises(MeshError, match=r"part\.stl is open: 3 edges lack"):
        check_closed(surface.triangles[1:], surface.points, "part.stl")


def test_disagreeing_normals_are_named() -> None:
    surface = tetrahedron()
    triangles = surface.triangles.copy()
    triangles[0] = triangles[0, ::-1]
    with pytest.raises(MeshError, match="disagree on their normals"):
        check_closed(triangles, surface.points, "part.stl")


def test_shells_that_touch_stay_apart() -> None:
    along_an_edge = tidy(np.vstack([CORNERS, [[0, -1, 0], [0, 0, -1]]]), np.array([[0, 1, 2, 3], [0, 1, 4, 5]]))
    in_a_point = tidy(np.vstack([CORNERS, -CORNERS[1:]]), np.array([[0, 1, 2, 3], [0, 4, 6, 5]]))
    for two in (along_an_edge, in_a_point):
        check_closed(two.boundary(), two.points, "part")
        assert label_shells(two.boundary()).max() + 1 == 2


def test_surface_that_touches_itself_is_one_shell(cubes) -> None:
    cells = np.ones((3, 3, 2), bool)
    cells[0, 0, 1] = cells[1, 1, 1] = False  # two dents with one edge in common
    body = cubes(cells)
    check_closed(body.boundary(), body.points, "part")
    assert label_shells(body.boundary()).max() + 1 == 1


def test_repeated_corners_of_stl_become_one_node() -> None:
    surface = tetrahedron()
    soup = surface.points[surface.triangles].reshape(-1, 3)
    merged = merge_points(soup, np.arange(len(soup)).reshape(-1, 3), 1e-9)
    assert len(merged.points) == 4
    assert merged.volume() == pytest.approx(surface.volume(), rel=1e-8)
