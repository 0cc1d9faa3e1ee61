"""Laws of the viscous tangent: the elastic one at rest, blind to rigid turns, never negative."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.artifacts.mesh import Mesh
from softrl.fem.assembly import multiply_blocks
from softrl.fem.damping import add_rub, viscous, viscous_moduli
from softrl.fem.law import TANGENT
from softrl.fem.material import material_of
from tests.fem.bodies import hollow_box, model_of

LAWS = {
    "stable_neo_hookean": (1e6,),
    "st_venant_kirchhoff": (1e6,),
    "mooney_rivlin": (1.2e5, 0.3e5),
    "yeoh": (1.5e5, -1e4, 2e3),
}


def tangent(kernel: object, parameters: np.ndarray, f: np.ndarray) -> np.ndarray:
    a = np.zeros((9, 9))
    kernel(parameters, f, np.zeros((3, 3)), a, TANGENT)  # type: ignore[operator]
    return a


@pytest.mark.parametrize("law", LAWS)
def test_at_rest_it_is_the_elastic_tangent(law: str) -> None:
    material = material_of(law, LAWS[law], 0.45)
    elastic = tangent(type(material).kernel, material.pack(), np.eye(3))
    moduli, _ = viscous_moduli(material, mean_volume=False)
    assert np.abs(tangent(viscous, moduli, np.eye(3)) - elastic).max() < 1e-6 * np.abs(elastic).max()


def test_it_damps_every_motion_and_no_rigid_turn() -> None:
    rng = np.random.default_rng(3)
    moduli = viscous_moduli(material_of("stable_neo_hookean", (1e6,), 0.45), mean_volume=False)[0]
    for _ in range(20):
        f = np.eye(3) + 0.4 * rng.standard_normal((3, 3))
        a = tangent(viscous, moduli, f)
        assert np.linalg.eigvalsh(a).min() > -1e-9 * np.abs(a).max()
        spin = np.cross(np.eye(3), rng.standard_normal(3))
        assert np.abs(a @ (spin @ f).ravel()).max() < 1e-9 * np.abs(a).max()
        turn = np.kron(Rotation.from_rotvec(rng.standard_normal(3)).as_matrix(), np.eye(3))
        turned = tangent(viscous, moduli, (turn @ f.ravel()).reshape(3, 3))
        assert np.abs(turned - turn @ a @ turn.T).max() < 1e-9 * np.abs(a).max()


@pytest.mark.parametrize("mean_dilatation", [True, False])
def test_the_body_at_rest_is_damped_by_its_elastic_stiffness(mean_dilatation: bool) -> None:
    model = model_of(hollow_box(), mean_dilatation=mean_dilatation)
    elastic = model._elastic(model.rest(), TANGENT).blocks
    assert np.abs(model.viscous(model.rest()) - elastic).max() < 1e-9 * np.abs(elastic).max()


def test_a_turn_in_one_step_is_free_and_the_rub_has_the_derivatives_it_says(box: Mesh) -> None:
    rng, lam, mu = np.random.default_rng(5), 3e5, 2e5
    before = np.eye(3) + 0.2 * rng.standard_normal((3, 3))
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()

    def rub(f: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        p, a = np.zeros((3, 3)), np.zeros((9, 9))
        return add_rub(lam, mu, f, before, p, a, TANGENT), p, a

    assert rub(turn @ before)[0] < 1e-20 * mu and np.abs(rub(turn @ before)[1]).max() < 1e-10 * mu
    f, step = before + 0.1 * rng.standard_normal((3, 3)), 1e-6
    _, p, a = rub(f)
    for k, unit in enumerate(np.eye(9).reshape(9, 3, 3)):
        above, below = rub(f + step * unit), rub(f - step * unit)
        assert (above[0] - below[0]) / (2 * step) == pytest.approx(p.ravel()[k], rel=1e-6, abs=1e-6 * np.abs(p).max())
        np.testing.assert_allclose((above[1] - below[1]).ravel() / (2 * step), a[:, k], atol=1e-6 * np.abs(a).max())
    # and at a short step it is what the viscous tangent says
    model, small = model_of(box, rayleigh_stiffness_s=1e-3), 1e-6
    there = small * rng.standard_normal(model.coupling.unknowns)
    moved = model.coupling.move(model.rest(), there)
    force = model._elastic(moved, 1, 1e3 * np.array([*model._viscous_moduli, model._viscous_bulk]), model.rest().position)
    wanted = 1e3 * multiply_blocks(
        model.viscous(model.rest()), model.pairs.first, model.pairs.second, moved.position - model.rest().position
    )
    found = force.gradient - model._elastic(moved, 1).gradient
    assert np.abs(found - wanted).max() < 1e-2 * np.abs(wanted).max()
