"""Moments of displacements: what they are, how they turn, and how much of a moving mass they know."""

import numpy as np
import pytest

from softrl.artifacts.mesh import Mesh
from softrl.fem.moments import products, turned
from tests.fem.bodies import model_of

TURN = np.array([[-0.5, -(0.75**0.5), 0.0], [0.75**0.5, -0.5, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("vector", [TURN, np.diag([-1.0, 1.0, 1.0])])
def test_products_turn_as_their_points_do(vector: np.ndarray) -> None:
    points = np.random.default_rng(1).standard_normal((7, 3))
    there = products(points @ vector.T)
    assert there.shape == (7, 35)
    np.testing.assert_allclose(products(points) @ turned(vector, 35).T, there, atol=1e-12)


def test_of_a_rigid_motion_moments_know_the_whole_kinetic_energy(box: Mesh) -> None:
    model = model_of(box)
    shift, spin = np.array([0.3, -0.1, 0.2]), np.array([1.0, 2.0, -0.5])
    moved = shift + np.cross(spin, model.solid.points)
    moments = model.moments(moved)
    np.testing.assert_allclose(moments[0], model.nodal_mass @ moved)
    known = np.einsum("ai,ab,bi->", moments, np.linalg.pinv(model.moment_gram, rcond=1e-12), moments)
    assert known == pytest.approx(float((model.nodal_mass[:, None] * moved**2).sum()), rel=1e-9)
