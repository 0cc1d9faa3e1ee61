"""Laws of the rigid plate and ribs."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from softrl.artifacts.mesh import FIRST_RIB, Mesh
from softrl.fem.coupling import Coupling, Pose, quaternion_of
from softrl.fem.law import STRESS, TANGENT
from softrl.fem.model import FemModel
from tests.fem.bodies import model_of

LOAD = np.array([3e3, -1e3, 0.1, -0.2, 0.3])


@pytest.fixture(scope="module")
def model(box: Mesh) -> FemModel:
    """Return a box whose middle layer is a rigid rib."""
    region = box.node_region.copy()
    middle = np.isclose(box.points[:, 2], np.unique(np.round(box.points[:, 2], 6))[2], atol=1e-5)
    region[middle] = FIRST_RIB
    return model_of(replace(box, node_region=region))


@pytest.fixture(scope="module")
def coupling(model: FemModel) -> Coupling:
    return model.coupling


def somewhere(model: FemModel, seed: int) -> Pose:
    """Return a pose with turned bodies and shaken nodes."""
    change = 1e-4 * np.random.default_rng(seed).standard_normal(model.coupling.unknowns)
    for k in range(2):
        change[model.coupling.body_slice(k)][3:] *= 1e3
    return model.coupling.move(model.rest(), change)


def test_bodies_stay_rigid_and_the_base_stays(model: FemModel, coupling: Coupling) -> None:
    pose, rest = somewhere(model, 0), model.rest()
    for member in coupling.members:
        before = np.linalg.norm(rest.position[member][:, None] - rest.position[member], axis=2)
        after = np.linalg.norm(pose.position[member][:, None] - pose.position[member], axis=2)
        assert np.abs(after - before).max() < 1e-15
    base = coupling.body == -2
    assert (pose.position[base] == rest.position[base]).all()


def test_difference_undoes_move(model: FemModel, coupling: Coupling) -> None:
    here, there = somewhere(model, 1), somewhere(model, 2)
    again = coupling.move(here, coupling.difference(here, there))
    assert np.abs(again.position - there.position).max() < 1e-14
    assert np.abs(again.rotation - there.rotation).max() < 1e-14


def test_reduced_forces_do_the_work_of_nodal_forces(model: FemModel, coupling: Coupling) -> None:
    pose, rng = somewhere(model, 3), np.random.default_rng(4)
    force, change = rng.standard_normal(pose.position.shape), rng.standard_normal(coupling.unknowns)
    work = (force * coupling.expand(change, pose))[coupling.body != -2].sum()
    assert coupling.reduce(force, pose) @ change == pytest.approx(work, rel=1e-12)


def test_spread_force_makes_no_moment_in_any_orientation(model: FemModel, coupling: Coupling) -> None:
    pose = somewhere(model, 5)
    reduced = coupling.reduce(coupling.spread(0)[:, None] * np.array([1.0, -2.0, 0.5]), pose)
    assert np.allclose(reduced[coupling.body_slice(0)], [1.0, -2.0, 0.5, 0.0, 0.0, 0.0], atol=1e-13)


def test_gradient_and_hessian_in_the_unknowns(model: FemModel, coupling: Coupling) -> None:
    # spins are not additive, but second differences along one direction exp(s w) are the Hessian's quadratic form
    potential, pose, rng = model._potential(LOAD), somewhere(model, 6), np.random.default_rng(7)
    value = potential(pose, TANGENT)
    gradient = coupling.reduce(value.gradient, pose)
    upper = coupling.stiffness(value.blocks, value.gradient, pose)
    hessian = upper + sp.triu(upper, 1).T
    for scale in (np.ones(coupling.unknowns), np.r_[np.zeros(coupling.unknowns - 12), np.ones(12)]):
        along, step = scale * rng.standard_normal(coupling.unknowns), 1e-7
        above, below = (coupling.move(pose, s * step * along) for s in (1.0, -1.0))
        values = [potential(p, STRESS) for p in (above, below)]
        slope = (values[0].energy - values[1].energy) / (2 * step)
        assert slope == pytest.approx(gradient @ along, rel=1e-6)
        bend = sum(s * coupling.reduce(v.gradient, p) @ along
                   for s, v, p in zip((1, -1), values, (above, below), strict=True)) / (2 * step)
        assert bend == pytest.approx(along @ (hessian @ along), rel=1e-6)


def test_quaternion_of_a_rotation() -> None:
    turn = Rotation.random(rng=np.random.default_rng(8))
    quaternion = quaternion_of(turn.as_matrix())
    assert quaternion[0] >= 0
    assert np.allclose(Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), turn.as_matrix())
