"""Laws of the quadratic tetrahedra."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.mesh import BASE, PLATE, Mesh
from softrl.core.errors import MeshError
from softrl.fem.elements import EDGES, GAUSS, quadratic_mesh
from tests.fem.bodies import bar, hollow_box


def test_shape_gradients_reproduce_a_quadratic_field() -> None:
    quadratic = quadratic_mesh(bar((1, 2, 2), (0.01, 0.02, 0.03)))
    bend = np.random.default_rng(0).standard_normal((3, 3))

    def field(x: np.ndarray) -> np.ndarray:
        return x @ [1.0, 2.0, 3.0] + np.einsum("...i,ij,...j->...", x, bend, x) / 0.01

    nodal = field(quadratic.points)[quadratic.elements]
    found = np.einsum("ea,eqai->eqi", nodal, quadratic.gradients)
    where = np.einsum("qc,eci->eqi", GAUSS, quadratic.points[quadratic.elements[:, :4]])
    assert np.allclose(found, np.array([1.0, 2.0, 3.0]) + where @ (bend + bend.T) / 0.01, atol=1e-10)


def test_mid_edge_nodes_lie_in_the_middle_and_are_shared() -> None:
    mesh = bar((2, 2, 2), (0.01, 0.01, 0.01))
    quadratic = quadratic_mesh(mesh)
    ends = quadratic.points[quadratic.elements[:, EDGES]]
    assert np.allclose(quadratic.points[quadratic.elements[:, 4:]], ends.mean(axis=2))
    assert len(np.unique(np.round(quadratic.points, 9), axis=0)) == len(quadratic.points)


def test_mass_is_positive_and_keeps_total_and_centre(box: Mesh) -> None:
    quadratic = quadratic_mesh(box)
    mass = quadratic.lumped_mass(900.0)
    assert mass.min() > 0
    assert mass.sum() == pytest.approx(900.0 * box.volume())
    centre = np.average(box.points[box.tetrahedra].mean(axis=1), axis=0, weights=quadratic.volumes())
    assert np.allclose(np.average(quadratic.points, axis=0, weights=mass), centre)


def test_tip_is_the_centroid_of_the_plate_whatever_its_nodes() -> None:
    mesh = hollow_box(cells=3, width=0.03, height=0.04)
    assert np.allclose(quadratic_mesh(mesh).plate_centroid(), [0.015, 0.015, 0.035])
    face = bar((2, 2, 2), (0.02, 0.02, 0.03))
    assert np.allclose(quadratic_mesh(face).plate_centroid(), [0.01, 0.01, 0.03])


def test_mid_edge_nodes_belong_where_both_ends_do(box: Mesh) -> None:
    quadratic = quadratic_mesh(box)
    middle = quadratic.region[quadratic.corners :]
    both = quadratic.region[quadratic.edge_ends]
    for part in (BASE, PLATE):
        assert ((middle == part) == (both == part).all(axis=1)).all()


def test_a_cavity_that_is_no_part_of_the_mesh_is_refused(box: Mesh) -> None:
    stray = box.cavity_triangles.copy()
    stray[0, 0] = box.cavity_triangles[-1, -1]
    with pytest.raises(MeshError, match="no edges of tetrahedra"):
        quadratic_mesh(replace(box, cavity_triangles=stray))
