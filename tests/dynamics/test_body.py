"""The reduced model as a body under a gravity of its own."""

from dataclasses import replace

import numpy as np

from softrl.dynamics.body import ReducedBody
from softrl.pod.rom import tip_poses
from tests.pod.conftest import fitted


def test_a_body_without_weight_is_turned_by_none() -> None:
    model = fitted(3)[2]
    give_rotation = np.zeros_like(model.give_rotation)
    give_rotation[:, 0] = 1e-3 * np.arange(1.0, 10.0)  # rad s^2/m
    heavy = replace(model, give_rotation=give_rotation)
    weightless = replace(heavy, gravity_m_s2=np.zeros(3))
    z = 0.3 * np.random.default_rng(0).uniform(-1.0, 1.0, (4, model.order)) @ model.frame.T
    found = ReducedBody(heavy, np.zeros(3)).quaternion(z)
    np.testing.assert_allclose(found, tip_poses(weightless, z)[1], atol=1e-12)
    assert np.abs(found - tip_poses(heavy, z)[1]).max() > 1e-3
    own = ReducedBody(heavy, heavy.gravity_m_s2).quaternion(z)
    np.testing.assert_allclose(own, tip_poses(heavy, z)[1], atol=1e-12)
