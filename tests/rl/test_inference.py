"""The compiled chain decides what its parts decide one by one, and refuses what does not belong together."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.calibration.pressure_map import PressureMap
from softrl.core.errors import ArtifactError
from softrl.rl.inference import Inference
from softrl.rl.policy import act, joints, observation
from softrl.surrogate.maps import PressureToJoints


@pytest.fixture(scope="module")
def policy(surrogate: Surrogate) -> Policy:
    """Return an untrained policy of two hidden layers."""
    rng = np.random.default_rng(0)
    sizes = (15, 16, 16, 3)
    weights = {}
    for i, (size, rows) in enumerate(pairwise(sizes)):
        weights[f"weight_{i}"] = rng.normal(size=(rows, size)) / size**0.5
        weights[f"bias_{i}"] = 0.1 * rng.normal(size=rows)
    return Policy(
        weights, "tanh", "tanh", 2, surrogate.sample_tip.mean(axis=0), 0.03, 2.0, surrogate.joint_low,
        surrogate.joint_high, "track", {}, "none", 0.5, {}, surrogate.robot_name,
    )  # fmt: skip


@pytest.fixture(scope="module")
def calibration(surrogate: Surrogate) -> Calibration:
    """Return an f_RS that is no identity."""
    rng, n, m, h = np.random.default_rng(1), surrogate.chambers, 3, 6
    shapes = {"skip": (m, n, n), "bias": (m, n), "weight_0": (m, n, h), "bias_0": (m, h), "weight_1": (m, h, h),
              "bias_1": (m, h), "weight_2": (m, h, n)}  # fmt: skip
    weights = {name: 0.3 * rng.normal(size=shape) for name, shape in shapes.items()}
    wide = np.full(n, 1e9)
    holds = np.zeros((4, n))
    return Calibration(
        weights, m, np.zeros(n), np.full(n, 15e3), np.full(n, 500.0), -wide, wide, holds, holds, np.zeros(4, dtype=bool),
        "simulator", {}, surrogate.robot_name,
    )  # fmt: skip


@pytest.mark.parametrize("squash", ["tanh", "clip"])
@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_it_decides_what_its_parts_decide(
    policy: Policy, surrogate: Surrogate, calibration: Calibration, activation: str, squash: str
) -> None:
    policy = replace(policy, activation=activation, squash=squash)
    chain, maps, f_rs = Inference(policy, surrogate, calibration), PressureToJoints(surrogate), PressureMap(calibration)
    theta = maps.joints(np.zeros((1, 3)))
    rng = np.random.default_rng(2)
    for k in range(5):
        tip, ahead, force = surrogate.sample_tip[k], surrogate.sample_tip[k + 1 : k + 3], rng.uniform(0.0, 2.0, 2)
        seen = observation(policy, tip[None], theta, np.array([0.5]), ahead[None], force[None])
        theta = joints(policy, act(policy)(seen))
        decision = chain.decide(tip, 0.5, ahead, force)
        np.testing.assert_allclose(decision.theta, theta[0], atol=1e-6)
        np.testing.assert_allclose(decision.pressure, f_rs.sim_to_real(maps.pressure(theta))[0], atol=1.0)


def test_without_calibration_the_simulators_pressure_is_sent(policy: Policy, surrogate: Surrogate) -> None:
    decision = Inference(policy, surrogate, None).decide(surrogate.sample_tip[0], 0.0, surrogate.sample_tip[1:3])
    np.testing.assert_array_equal(decision.pressure, decision.simulated)


def test_reset_forgets(policy: Policy, surrogate: Surrogate) -> None:
    chain = Inference(policy, surrogate, None)
    first = chain.pressure(surrogate.sample_tip[0], 0.0, surrogate.sample_tip[1:3])
    assert np.abs(chain.pressure(surrogate.sample_tip[0], 0.0, surrogate.sample_tip[1:3]) - first).max() > 0.0
    chain.reset()
    np.testing.assert_array_equal(chain.pressure(surrogate.sample_tip[0], 0.0, surrogate.sample_tip[1:3]), first)


def test_what_does_not_belong_together_is_refused(
    policy: Policy, surrogate: Surrogate, calibration: Calibration
) -> None:
    with pytest.raises(ArtifactError, match="robot other"):
        Inference(replace(policy, robot_name="other"), surrogate, calibration)
    with pytest.raises(ArtifactError, match="robot other"):
        Inference(policy, surrogate, replace(calibration, robot_name="other"))
    with pytest.raises(ArtifactError, match="another surrogate"):
        Inference(replace(policy, joint_high=1.5 * policy.joint_high), surrogate, calibration)
    with pytest.raises(ArtifactError, match="looks at 2 targets"):
        Inference(policy, surrogate, None).decide(surrogate.sample_tip[0], 0.0, surrogate.sample_tip[:3])
