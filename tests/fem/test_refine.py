"""Cutting a mesh finer keeps the solid and its parts; a shape carried over to it stays the same shape."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.mesh import BASE, FIRST_RIB, FREE, PLATE, Mesh
from softrl.fem.refine import carried, refine
from tests.fem.bodies import boundary, model_of


@pytest.mark.parametrize("parts", [2, 3, 4])
def test_a_finer_mesh_is_the_same_solid_with_the_same_parts(box: Mesh, parts: int) -> None:
    fine = refine(box, parts)
    fine.validate()
    assert len(fine.tetrahedra) == parts**3 * len(box.tetrahedra)
    assert fine.volume() == pytest.approx(box.volume(), rel=1e-12)
    for chamber in range(2):
        assert fine.cavity_volume(chamber) == pytest.approx(box.cavity_volume(chamber), rel=1e-12)
    # conforming: no faces inside but those that two tetrahedra share
    assert len(boundary(fine.tetrahedra)) == parts**2 * len(boundary(box.tetrahedra))
    assert len(np.unique(np.round(fine.points, 9), axis=0)) == len(fine.points)
    faces = {tuple(f) for f in np.sort(boundary(fine.tetrahedra), axis=1)}
    assert {tuple(f) for f in np.sort(fine.cavity_triangles, axis=1)} <= faces


def test_regions_of_a_finer_mesh_are_those_of_quadratic_elements(box: Mesh) -> None:
    region = box.node_region.copy()
    region[np.isclose(box.points[:, 2], np.unique(np.round(box.points[:, 2], 6))[2], atol=1e-5)] = FIRST_RIB
    box = Mesh(**(vars(box) | {"node_region": region}))
    quadratic, fine = model_of(box).solid, refine(box, 2)
    order = np.lexsort(np.round(quadratic.points, 7).T), np.lexsort(np.round(fine.points, 7).T)
    assert np.abs(quadratic.points[order[0]] - fine.points[order[1]]).max() < 1e-12
    assert (quadratic.region[order[0]] == fine.node_region[order[1]]).all()
    assert set(np.unique(fine.node_region)) == {FREE, BASE, PLATE, FIRST_RIB}


@pytest.mark.parametrize(("order", "first", "second"), [(1, 1, 2), (2, 1, 2), (2, 2, 3)])
def test_a_carried_shape_is_the_same_shape(box: Mesh, order: int, first: int, second: int) -> None:
    coarse, fine = (
        model_of(refine(box, parts), mean_dilatation=False, element_order=order) for parts in (first, second)
    )
    # linear in each of the finest tetrahedra: every element can follow it, whoever contains whom
    bend = np.array([[1.02, 0.1, 0.0], [-0.1, 0.97, 0.05], [0.0, 0.03, 1.1]])
    rest = coarse.rest()
    shape = carried(coarse, replace(rest, position=rest.position @ bend.T), fine, box)
    free = fine.coupling.free
    assert np.allclose(shape.position[free], (fine.solid.points @ bend.T)[free], atol=1e-12)
    pose = coarse.static(np.array([4e3, -2e3, 0.2, -0.1, 0.15])).pose
    shape = carried(coarse, pose, fine, box)
    moved = np.abs(pose.position - rest.position).max()
    assert np.allclose(fine.volumes(shape), coarse.volumes(pose), rtol=1e-9 if first == 1 else 1e-4)
    assert np.allclose(fine.tip(shape) - fine.rest_tip, coarse.tip(pose) - coarse.rest_tip, atol=1e-3 * moved)
    assert fine.static(np.array([4e3, -2e3, 0.2, -0.1, 0.15]), shape).iterations <= 6
