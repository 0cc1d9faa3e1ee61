"""FElupe, a finite-element code of other authors, on the tripod: same mesh, same law, pressure and tip force."""

import numpy as np
import pytest

from softrl.artifacts.mesh import BASE, FREE
from softrl.fem.loads import add_volume_gradient
from softrl.fem.material import Yeoh
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings
from tests.reference.tripod import sample_mesh

felupe = pytest.importorskip("felupe", reason="FElupe is not installed: pip install softrl[test]")
LOAD = np.array([2e4, 0.0, 0.0, 0.3, 0.0, -0.2])  # Pa, N


def test_felupe_finds_the_same_equilibrium_of_the_tripod() -> None:
    # both solve the 10-node tetrahedra; FElupe is given where the rigid parts are and the pressure's forces, and must
    # find the free nodes, and forces on the rigid parts that balance the load
    material = Yeoh(2.5e5, 0.0, 0.0, 0.45)  # its first term is FElupe's NeoHooke
    model = FemModel(
        sample_mesh("tiny"), material, 1000.0, 0.0, 0.0, NewtonSettings(1e-9, 60, 0.3), mean_dilatation=False
    )
    solve = model.static(LOAD)
    assert solve.converged
    solid, moved = model.solid, solve.pose.position - model.solid.points
    push = np.zeros_like(moved)
    add_volume_gradient(solve.pose.position, *model._surface, LOAD[:3], push)

    mesh = felupe.Mesh(solid.points, solid.elements, "tetra10")
    field = felupe.FieldContainer([felupe.Field(felupe.RegionQuadraticTetra(mesh), dim=3)])
    c1, _, _, kappa = material.pack()
    body = felupe.SolidBody(felupe.NeoHooke(mu=2 * c1, bulk=kappa), field)
    held, free = np.flatnonzero(solid.region != FREE), np.flatnonzero(solid.region == FREE)
    found = felupe.newtonraphson(
        items=[body, felupe.PointLoad(field, np.arange(len(push)), push)],
        dof0=unknowns(held),
        dof1=unknowns(free),
        ext0=moved[held].ravel(),
        tol=1e-9,
        maxiter=30,
        verbose=False,
    )
    assert found.success
    apart = np.abs(field[0].values - moved).max()
    assert apart < 1e-6 * np.abs(moved).max(), f"{apart:.1e} m apart"

    force = body.assemble.vector(field).toarray().reshape(-1, 3) - push
    for k, member in enumerate(model.coupling.members):
        wanted = LOAD[3:] if k == 0 else np.zeros(3)
        arm = solve.pose.position[member] - solve.pose.centre[k]
        assert np.abs(force[member].sum(axis=0) - wanted).max() < 1e-5
        assert np.abs(np.cross(arm, force[member]).sum(axis=0)).max() < 1e-6
    assert (np.abs(moved[solid.region == BASE]) == 0).all()


def unknowns(nodes: np.ndarray) -> np.ndarray:
    """Return the numbers of the displacements of ``nodes``."""
    return (3 * nodes[:, None] + np.arange(3)).ravel()
