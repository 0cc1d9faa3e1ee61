"""Lags: none at rest, and with them a short step answers as the full model does."""

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.fem.coupling import Pose
from softrl.fem.lag import Lag, lag_of, push_of
from softrl.fem.model import FemModel
from softrl.fem.tangent import Tangent
from tests.fem.bodies import model_of

LOAD = np.array([1.5e5, -1e4, 2.0, 1.0, -3.0])


def lags(model: FemModel, pose: Pose, tangent: Tangent) -> Lag:
    push = push_of(model, pose, tangent)
    return lag_of(model, pose, tangent, push, model.solve(push))


def test_a_body_at_rest_has_no_lags(box: Mesh) -> None:
    model = model_of(box)
    tangent = model.tangent(model.rest(), np.zeros(5))
    lag = lags(model, model.rest(), tangent)
    assert np.abs(lag.stiffness @ tangent.compliance).max() < 1e-6


def test_lags_make_a_short_step_that_of_the_full_model(box: Mesh) -> None:
    b, dt = 4e-3, 1e-3
    model = model_of(box, rayleigh_stiffness_s=b)
    pose = model.static(LOAD).pose
    tangent = model.tangent(pose, LOAD)
    lag, inverse = lags(model, pose, tangent), np.linalg.inv(tangent.compliance)
    assert np.linalg.eigvalsh(lag.stiffness).min() > -1e-9 * np.linalg.eigvalsh(lag.stiffness).max()
    inertia = inverse @ tangent.mass @ inverse / dt**2
    damping = inverse @ tangent.stiffness @ inverse * b / dt
    inner = lag.stiffness + lag.viscosity * b / dt
    shared = lag.stiffness @ np.linalg.pinv(inner, rcond=1e-9) @ lag.stiffness * (b / dt) ** 2
    nudge = 1e-4 * LOAD
    state, _ = model.step(model.state(pose), LOAD + nudge, dt)
    moved = model.coordinate(state.pose) - model.coordinate(pose)
    error = [
        np.abs(np.linalg.solve(inverse + inertia + matrix, nudge) - moved)[:2].max() / np.abs(moved[:2]).max()
        for matrix in (damping, damping - shared)
    ]
    assert error[1] < 0.4 * error[0], error
