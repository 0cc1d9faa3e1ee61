"""Running a policy from its arrays alone."""

from collections.abc import Callable

import numpy as np

from softrl.artifacts.policy import Policy
from softrl.core.errors import ArtifactError
from softrl.rl.actor import Actor, act_scaled
from softrl.rl.batch import Scales, command_of, observe, remembered

Act = Callable[[np.ndarray], np.ndarray]


def act(policy: Policy, robot_name: str | None = None) -> Act:
    """Return the deterministic controller: observations (B, k) -> actions (B, 3) in -1 .. 1.

    Raises
    ------
    ArtifactError
        If the policy is of another robot than ``robot_name``, or, when called, if the observations have another length.
    """
    if robot_name not in (None, policy.robot_name):
        raise ArtifactError(
            f"the policy was trained for robot {policy.robot_name}, but robot={robot_name}; rerun stage=rl"
        )
    actor = Actor(policy.weights, policy.activation, policy.squash)

    def run(observation: np.ndarray) -> np.ndarray:
        rows = np.atleast_2d(observation)
        if rows.shape[1] != policy.observation_size:
            raise ArtifactError(
                f"the policy takes observations of length {policy.observation_size} (horizon {policy.horizon}, memory "
                f"{policy.memory}), not {rows.shape[1]}; build them with softrl.rl.policy.observation"
            )
        return act_scaled(actor, rows)

    return run


def observation(
    policy: Policy,
    tip: np.ndarray,
    theta: np.ndarray,
    contact_force: np.ndarray,
    position: np.ndarray,
    force: np.ndarray,
    past_tip: np.ndarray | None = None,
    past_theta: np.ndarray | None = None,
) -> np.ndarray:
    """Return the observations (B, k) that ``policy`` was trained on, from SI values.

    A policy that is told joints gets all positions through ``workspace.told_as_joints`` first.

    Parameters
    ----------
    tip : (B, 3) m;  theta : (B, 3) grouped command that acts;  contact_force : (B,) N
    position : (B, horizon, 3) m and force : (B, horizon) N of the targets, the one to reach next first
    past_tip, past_theta : (B, memory, 3) of the readings before, the latest first; for a policy with a memory only
    """
    p = policy
    scales = Scales(p.position_centre, p.position_scale, p.force_scale, p.joint_low, p.joint_high)
    seen = observe(scales, tip, theta, contact_force, position, force)
    if past_tip is None or past_theta is None:
        return seen
    return np.hstack([seen, remembered(scales, past_tip, past_theta)])


def joints(policy: Policy, action: np.ndarray) -> np.ndarray:
    """Return the grouped joint commands (B, 3) rad, rad, m of actions (B, 3)."""
    return command_of(action, policy.joint_low, policy.joint_high)
