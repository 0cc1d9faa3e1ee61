"""Cutting a mesh finer keeps the solid; tips of finer meshes converge to the limit that is extrapolated."""

import numpy as np
import pytest

from softrl.artifacts.mesh import BASE, FIRST_RIB, FREE, PLATE, Mesh
from softrl.core.errors import ConfigError, SolverError
from softrl.fem.convergence import draw_convergence, extrapolate, refine, study
from softrl.fem.material import StableNeoHookean
from softrl.fem.newton import NewtonSettings
from tests.fem.bodies import NEWTON, boundary, hollow_box, model_of
from tests.reference.tripod import sample_mesh


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


def test_extrapolation_finds_order_and_limit_of_a_power() -> None:
    edge, limit, slope = np.array([1.0, 0.5, 0.3]), np.array([1.0, -2.0, 3.0]), np.array([0.1, 0.3, -0.2])
    order, found = extrapolate(edge, limit + slope * edge[:, None] ** 2.3)
    assert order == pytest.approx(2.3, abs=1e-9)
    assert np.allclose(found, limit, atol=1e-9)
    with pytest.raises(SolverError, match="does not converge"):
        extrapolate(edge, np.array([[0.0, 0, 0], [0.1, 0, 0], [10.0, 0, 0]]))
    with pytest.raises(ConfigError, match="three or more"):
        study(hollow_box(), StableNeoHookean(1e6, 0.4), np.zeros(4), NEWTON, (1, 2))


@pytest.mark.slow
def test_quadratic_elements_do_not_lock_near_incompressibility() -> None:
    # a box of one element a wall: how much stiffer than a finer one it is, compressible and nearly not
    mesh, load = hollow_box(cells=4, walls=1), np.array([1e3, 0.01, 0.0, 0.0])

    def tip(nu: float, parts: int, mean: bool) -> float:
        model = model_of(refine(mesh, parts), StableNeoHookean(1e6, nu), mean_dilatation=mean)
        return float(np.linalg.norm(model.tip(model.static(load).pose) - model.rest_tip))

    share = {(nu, mean): tip(nu, 1, mean) / tip(nu, 2, mean) for nu in (0.3, 0.49) for mean in (True, False)}
    assert abs(share[0.49, True] - share[0.3, True]) < 0.01, f"measured {share}"
    assert abs(share[0.49, False] - share[0.3, False]) < 0.03, f"measured {share}"
    assert all(abs(value - 1.0) < 0.06 for value in share.values()), f"measured {share}"


@pytest.mark.slow
def test_the_tip_of_a_tripod_converges_over_three_meshes() -> None:
    # three bulges; measured 10.1, 1.4 and 0.4 % on 13 000, 89 000 and 282 000 unknowns
    found = study(
        sample_mesh("tiny"),
        StableNeoHookean(1.6e6, 0.45),
        np.array([2e4, 0.0, 0.0, 0.0, 0.0, 0.0]),
        NewtonSettings(1e-6, 40, 0.3),
        mean_dilatation=False,
    )
    assert (np.diff(found.error_pct) < 0).all() and found.error_pct[1] < 2.0, f"measured {found.error_pct} %"
    assert draw_convergence({"tripod": found}).axes[0].get_lines()
