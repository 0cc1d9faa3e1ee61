"""Many copies of a task on the twin, stepped together in NumPy; the gymnasium and SB3 environments stand on it."""

from typing import NamedTuple

import numpy as np

from softrl.artifacts.policy import observation_size
from softrl.rl.tasks.task import Goals, Seen, Task
from softrl.rl.workspace import Workspace
from softrl.surrogate.twin import TwinState

OBSERVATION_LIMIT = 10.0
PATCH_SEED = 1
TIP, THETA = slice(0, 3), slice(3, 6)  # columns of an observation: where the tip is, and the last command as an action


class Scales(NamedTuple):
    """What turns SI values into an observation: see ``Policy``."""

    centre: np.ndarray
    position: float
    force: float
    joint_low: np.ndarray
    joint_high: np.ndarray


class Step(NamedTuple):
    """Result of one step of a batch: observation (B, k), reward (B,), errors (B,) m and N."""

    observation: np.ndarray
    reward: np.ndarray
    position_error: np.ndarray
    force_error: np.ndarray


def scales_of(task: Task, space: Workspace) -> Scales:
    """Return the scales of a task on a surrogate."""
    return Scales(space.centre, space.scale, task.force_unit_n, space.surrogate.joint_low, space.surrogate.joint_high)


def observe(
    scales: Scales,
    tip: np.ndarray,
    theta: np.ndarray,
    contact_force: np.ndarray,
    position: np.ndarray,
    force: np.ndarray,
) -> np.ndarray:
    """Return observations (B, 7 + 4 horizon), float32, by eq. 19 with the next targets.

    Parameters
    ----------
    tip : (B, 3) m;  theta : (B, 3) grouped command that acts;  contact_force : (B,) N
    position : (B, horizon, 3) m and force : (B, horizon) N of the targets, the one to reach next first
    """
    span = scales.joint_high - scales.joint_low
    targets = np.concatenate([(position - scales.centre) / scales.position, force[..., None] / scales.force], axis=2)
    parts = [
        (tip - scales.centre) / scales.position, 2.0 * (theta - scales.joint_low) / span - 1.0,
        contact_force[:, None] / scales.force, targets.reshape(len(tip), -1),
    ]  # fmt: skip
    return np.clip(np.hstack(parts), -OBSERVATION_LIMIT, OBSERVATION_LIMIT).astype(np.float32)


def remembered(scales: Scales, tip: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return what a policy with a memory sees besides (B, 6 memory): tips (B, memory, 3) m, commands (B, memory, 3)."""
    span = scales.joint_high - scales.joint_low
    parts = [(tip - scales.centre) / scales.position, 2.0 * (theta - scales.joint_low) / span - 1.0]
    seen = np.concatenate(parts, axis=2).reshape(len(tip), -1)
    return np.clip(seen, -OBSERVATION_LIMIT, OBSERVATION_LIMIT).astype(np.float32)


def action_of(theta: np.ndarray, joint_low: np.ndarray, joint_high: np.ndarray) -> np.ndarray:
    """Return the actions (B, 3) in -1 .. 1 that ask for grouped commands (B, 3): the inverse of ``command_of``."""
    return np.clip(2.0 * (theta - joint_low) / (joint_high - joint_low) - 1.0, -1.0, 1.0)


def command_of(action: np.ndarray, joint_low: np.ndarray, joint_high: np.ndarray) -> np.ndarray:
    """Return the grouped commands (B, 3) of actions (B, 3) in -1 .. 1 (eq. 20: absolute, scaled to the limits)."""
    share = 0.5 + 0.5 * np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
    return joint_low + share * (joint_high - joint_low)


class Batch:
    """``size`` episodes side by side, each on a curve of its own.

    Attributes
    ----------
    approach : steps at the first target before an episode counts; the twin needs none
    episode_steps : of a training episode
    expert_columns : columns of an observation that the expert's answer depends on
    differences : (k, m), observations to those differences of theirs that tell how the last command is to change, where
        a robot in motion is to come to its target whatever shifts it; None where each command is found anew
    """

    approach = 0

    def __init__(self, task: Task, space: Workspace, goals: Goals, size: int) -> None:
        self.task, self.space, self.goals, self.size = task, space, goals, size
        self.scales, self.plane = scales_of(task, space), task.plane(space)
        self.observation_size = observation_size(task.horizon)
        self.theta, self.tip, self.contact_force = np.zeros((size, 3)), np.zeros((size, 3)), np.zeros(size)
        self.curve, self.phase, self.direction = (np.zeros(size, dtype=int) for _ in range(3))
        self.elapsed, self.push = np.zeros(size, dtype=int), np.zeros((size, 3))
        self.episode_steps, self.expert_columns = task.episode_steps + self.approach, task.seen_by_expert()
        self.differences: np.ndarray | None = None
        self._patches = np.random.default_rng(PATCH_SEED)  # of the ground; training draws its own

    def start(
        self,
        which: np.ndarray,
        theta: np.ndarray,
        curve: np.ndarray,
        phase: np.ndarray,
        direction: np.ndarray,
        push: np.ndarray | None = None,
    ) -> None:
        """Start the episodes ``which`` from equilibrium under ``theta``, on given curves, phases and directions (+1, -1).

        ``push`` (which, 3) N acts on the tips and is shown to nobody; none by default.
        """
        self.theta[which], self.curve[which], self.phase[which] = theta, curve, phase
        self.direction[which], self.elapsed[which] = direction, 0
        self.push[which] = 0.0 if push is None else push
        state = self._equilibrium(self.theta[which], self.push[which], None)
        self.tip[which], self.contact_force[which] = state.tip, state.contact_force

    def start_random(self, which: np.ndarray, rng: np.random.Generator) -> None:
        """Start the episodes ``which`` (indices) from sampled commands, on random curves, under random forces."""
        count, samples = len(which), self.space.surrogate.sample_joints
        self._patches = rng
        self.start(
            which, samples[rng.integers(len(samples), size=count)], rng.integers(len(self.goals.position), size=count),
            rng.integers(self.goals.position.shape[1], size=count), rng.choice([-1, 1], size=count),
            self.task.disturbance_n * rng.uniform(-1.0, 1.0, (count, 3)),
        )  # fmt: skip

    def spread(self, rng: np.random.Generator) -> None:
        """Set the clocks so that episodes that began together do not end together."""
        self.elapsed[:] = rng.integers(self.episode_steps, size=self.size)

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the next targets: positions (B, horizon, 3) m and forces (B, horizon) N."""
        ahead = np.maximum(self.elapsed[:, None] - self.approach + np.arange(self.task.horizon), 0)
        at = (self.phase[:, None] + self.direction[:, None] * ahead) % self.goals.position.shape[1]
        return self.goals.position[self.curve[:, None], at], self.goals.force[self.curve[:, None], at]

    def observation(self) -> np.ndarray:
        """Return what the controllers see, (B, k)."""
        return observe(self.scales, self.tip, self.theta, self.contact_force, *self.targets())

    def expert_action(self) -> np.ndarray:
        """Return the model-based controller's actions (B, 3) in -1 .. 1."""
        position, force = self.targets()
        theta = self.task.answer(Seen(position[:, 0], force[:, 0], self.tip, self.theta), self.space)
        return action_of(theta, self.scales.joint_low, self.scales.joint_high)

    def step(self, action: np.ndarray) -> Step:
        """Move to the equilibria under ``action`` (B, 3) and judge them against the targets they were for."""
        position, force = (target[:, 0] for target in self.targets())
        self.theta = command_of(action, self.scales.joint_low, self.scales.joint_high)
        state = self._equilibrium(self.theta, self.push, self.tip)
        self.tip, self.contact_force = state.tip, state.contact_force
        self.elapsed += 1
        position_error = self.task.position_error(self.tip, position, self.plane)
        force_error = np.abs(self.contact_force - force)
        return Step(self.observation(), self.task.reward(position_error, force_error), position_error, force_error)

    def _equilibrium(self, theta: np.ndarray, push: np.ndarray, before: np.ndarray | None) -> TwinState:
        plane, friction = self.task.ground(self.plane, len(theta), self._patches)
        return self.space.twin.solve(theta, push if push.any() else None, plane, friction, before, refuse=False)
