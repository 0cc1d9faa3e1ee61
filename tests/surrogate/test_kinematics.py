"""Closed form against finite differences and against PyBullet's own forward kinematics."""

from dataclasses import replace

import numpy as np
import pybullet as bullet
import pytest

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ArtifactError
from softrl.core.tracking import NullTracker
from softrl.surrogate.fit import fit_joints, fit_joints_lbfgsb
from softrl.surrogate.kinematics import chain_from, chain_of, grouped_poses, joint_jacobians
from softrl.surrogate.parity import SETTLING, fit_joints_by_simulation
from softrl.surrogate.report import reached_pct, report_workspace
from softrl.surrogate.world import SurrogateState, World

CHAIN = chain_from(np.array([0.02, 0.06, 0.1]), np.array([0.04, 0.08, 0.12]), 0.15)


def commands(count: int = 20) -> np.ndarray:
    """Return random grouped commands."""
    return np.random.default_rng(3).uniform([-0.3, -0.3, -0.005], [0.3, 0.3, 0.008], (count, 3))


def test_the_jacobian_is_the_derivative() -> None:
    theta, jacobian = commands(), grouped_poses(commands(), CHAIN)[2]
    for j in range(3):
        nudge = 1e-6 * np.eye(3)[j]
        slope = (grouped_poses(theta + nudge, CHAIN)[0] - grouped_poses(theta - nudge, CHAIN)[0]) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, j], slope, atol=1e-9)


def test_single_joints_add_up_to_the_grouped_command() -> None:
    single = joint_jacobians(commands(), CHAIN).reshape(20, 3, -1, 3).sum(axis=2)
    np.testing.assert_allclose(single, grouped_poses(commands(), CHAIN)[2], atol=1e-12)


def test_signs_and_rest() -> None:
    tips, quaternions, _ = grouped_poses(np.array([[0.0, 0, 0], [0, 0.1, 0], [0.1, 0, 0], [0, 0, 0.001]]), CHAIN)
    np.testing.assert_allclose(tips[0], [0, 0, 0.15], atol=1e-15)
    np.testing.assert_array_equal(quaternions[0], [1, 0, 0, 0])
    assert tips[1, 0] > 0.01 and tips[2, 1] < -0.01
    assert tips[3, 2] == pytest.approx(0.153)


def test_pybullet_sees_the_same_chain(surrogate: Surrogate) -> None:
    world = World(surrogate, 1.0, SETTLING, 1.0)
    for theta in np.random.default_rng(0).uniform(surrogate.joint_low, surrogate.joint_high, (10, 3)):
        q = np.tile(theta, surrogate.gaps)
        tip, quaternion = world.pose(SurrogateState(q, np.zeros_like(q)))
        tips, quaternions, _ = grouped_poses(theta[None], chain_of(surrogate))
        np.testing.assert_allclose(tip, tips[0], atol=1e-6)
        np.testing.assert_allclose(quaternion, quaternions[0], atol=1e-6)
    masses = [bullet.getDynamicsInfo(world.body, i, physicsClientId=world._client)[0] for i in world.joints]
    assert sum(masses) == pytest.approx(surrogate.mass, rel=1e-3)
    world.close()


def test_fits_by_both_methods_agree_and_keep_the_limits() -> None:
    low, high = np.array([-0.2, -0.2, -0.004]), np.array([0.2, 0.2, 0.006])
    tips = grouped_poses(commands(), CHAIN)[0]
    newton, searched = fit_joints(CHAIN, tips, low, high), fit_joints_lbfgsb(CHAIN, tips, low, high)
    inside = ((commands() > low) & (commands() < high)).all(axis=1)
    assert inside.any() and not inside.all()
    np.testing.assert_allclose(newton.theta[inside], commands()[inside], atol=1e-7)
    assert (newton.theta >= low).all() and (newton.theta <= high).all()
    np.testing.assert_allclose(newton.residual, searched.residual, atol=1e-5)


def test_the_papers_search_finds_the_same_joints(surrogate: Surrogate) -> None:
    found = fit_joints_by_simulation(surrogate, surrogate.sample_tip[:2])
    np.testing.assert_allclose(found.theta, surrogate.sample_joints[:2], atol=2e-3)
    assert found.residual.max() < 1e-3


def test_a_surrogate_with_falling_heights_is_refused(surrogate: Surrogate) -> None:
    with pytest.raises(ArtifactError, match="rise"):
        replace(surrogate, tip_height=0.01).validate()


def test_limits_that_exclude_the_rest_pose_are_refused(surrogate: Surrogate) -> None:
    with pytest.raises(ArtifactError, match="exclude the rest pose"):
        replace(surrogate, joint_low=np.array([-0.1, 0.02, -0.01])).validate()


def test_coverage_counts_the_tips_within_reach(surrogate: Surrogate) -> None:
    assert reached_pct(surrogate, surrogate.sample_tip[:50]) > 95.0
    assert reached_pct(surrogate, surrogate.sample_tip[:50] + np.array([0.0, 0.0, 0.1])) == 0.0


def test_the_workspaces_of_full_model_and_robot_are_told_where_there_are_any(surrogate: Surrogate) -> None:
    tracker, tips = NullTracker(), surrogate.sample_tip[:8]
    report_workspace(surrogate, tips, np.empty((0, 3)), tracker)
    assert tracker.metrics == {"workspace_full_model_reached_pct": 100.0, "workspace_full_model_tips_count": 8.0}
