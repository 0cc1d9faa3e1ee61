import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.core.errors import MeshError
from softrl.mesh.quality import check_orientation, check_slivers, dihedral_angles, smallest_dihedral
from softrl.mesh.tetrahedra import Tetrahedra

REGULAR = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
ONE = np.array([[0, 1, 2, 3]])


def test_angles_of_known_tetrahedra() -> None:
    assert dihedral_angles(Tetrahedra(REGULAR, ONE)) == pytest.approx(np.rad2deg(np.arccos(1 / 3)))
    expected = [np.rad2deg(np.arccos(1 / np.sqrt(3)))] * 3 + [90.0] * 3
    assert np.sort(dihedral_angles(Tetrahedra(CORNER, ONE))[0]) == pytest.approx(expected)


def test_angles_do_not_depend_on_place_size_or_order() -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(size=(4, 3))
    moved = 1e-3 * Rotation.random(rng=rng).apply(points)[[2, 0, 3, 1]] + 7.0
    a, b = (dihedral_angles(Tetrahedra(p, ONE))[0] for p in (points, moved))
    assert np.sort(a) == pytest.approx(np.sort(b), rel=1e-6)


def test_smallest_angle_goes_to_zero_with_the_height() -> None:
    heights = np.array([0.1, 0.05, 0.025])
    flat = [smallest_dihedral(Tetrahedra(CORNER * [1, 1, h], ONE))[0] for h in heights]
    assert np.array(flat[:-1]) / flat[1:] == pytest.approx([2.0, 2.0], rel=0.02)


def test_inverted_elements_and_slivers_are_named_with_their_place() -> None:
    points = 0.01 * np.vstack([CORNER, CORNER + 5.0])
    inverted = Tetrahedra(points, np.array([[0, 1, 2, 3], [4, 6, 5, 7]]))
    with pytest.raises(MeshError, match=r"1 inverted or flat of 2 tetrahedra.*\(52\.5, 52\.5, 52\.5\) mm"):
        check_orientation(inverted, "part")
    sliver = Tetrahedra(CORNER * [1, 1, 0.01], ONE)
    with pytest.raises(MeshError, match=r"1 slivers.*0\.\d+ deg"):
        check_slivers(sliver, 3.0, "part")
    check_slivers(sliver, 0.1, "part")
