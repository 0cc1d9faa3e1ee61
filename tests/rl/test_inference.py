"""The compiled chain decides what its parts decide one by one, and refuses what does not belong together."""

from dataclasses import replace
from functools import partial
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
from softrl.rl.workspace import Workspace, told_as_joints
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


@pytest.mark.parametrize("told_as", ["position", "joints"])
def test_it_remembers_what_the_training_showed(policy: Policy, surrogate: Surrogate, told_as: str) -> None:
    rng, memory = np.random.default_rng(3), 2
    weight = rng.normal(size=(16, 15 + 6 * memory)) / 4.0
    policy = replace(policy, weights=policy.weights | {"weight_0": weight}, memory=memory, told_as=told_as)
    if told_as == "joints":
        policy = replace(policy, position_centre=np.zeros(3), position_scale=1.0)
    policy.validate()
    space = Workspace(surrogate)
    told = (lambda tip: tip) if told_as == "position" else partial(told_as_joints, space)
    chain, maps = Inference(policy, surrogate, None), PressureToJoints(surrogate)
    rest = maps.joints(np.zeros((1, 3)))
    tips, thetas = [told(surrogate.sample_tip[0])] * memory, [rest[0]] * (memory + 1)
    for k in range(4):
        tip, ahead = surrogate.sample_tip[k], surrogate.sample_tip[k + 1 : k + 3]
        now, targets = told(tip), told(ahead)
        past = np.stack(tips[-memory:][::-1])[None], np.stack(thetas[-memory - 1 : -1][::-1])[None]
        seen = observation(policy, now[None], thetas[-1][None], np.zeros(1), targets[None], np.zeros((1, 2)), *past)
        expected = maps.joints(maps.pressure(joints(policy, act(policy)(seen))))[0]  # what pressures in range can ask for
        np.testing.assert_allclose(chain.decide(tip, 0.0, ahead).theta, expected, atol=1e-6)
        tips.append(now)
        thetas.append(expected)


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
