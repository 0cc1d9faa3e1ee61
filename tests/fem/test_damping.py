"""Laws of the viscous tangent: the elastic one at rest, blind to rigid turns, never negative."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.fem.damping import viscous, viscous_moduli
from softrl.fem.material import TANGENT, material_of
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
