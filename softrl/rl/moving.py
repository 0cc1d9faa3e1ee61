"""Episodes in a simulator in motion: valves that lag, walls that creep, whatever effects a diagnosis found.

A policy sees the next targets and its past: tips and commands, all told as joints. The expert that it is compared with knows
what is hidden from it, the plant's state and a force on the tip, and answers to the same targets with the simulator linearised
about a plan of the whole course.
"""

from dataclasses import dataclass, replace

import numpy as np

from softrl.artifacts.policy import observation_size
from softrl.core.errors import ConfigError
from softrl.rl.batch import THETA, TIP, Batch, Step, action_of, command_of, observe, remembered
from softrl.rl.inversion import Inversion, Plan, Route, plan
from softrl.rl.running import FAST, Run
from softrl.rl.tasks.task import Goals, Task
from softrl.rl.workspace import Workspace, told_as_joints
from softrl.surrogate.maps import PressureToJoints

CORNER_STEPS = (4, 16)  # targets between two corners of a polygon, shortest and longest


@dataclass(frozen=True)
class Motion:
    """Training in a simulator in motion.

    Attributes
    ----------
    always : also where the simulator has no effects; with effects it is always so
    courses : random target sequences that training draws from
    approach_steps : commands at the first target before an episode counts
    average_window : commands in the moving average before the driver
    horizon : targets that a policy sees and acts for, as the expert does;  memory_steps : past tips and commands that it sees
    noise_mm : standard deviation per axis of the tip's reading while training
    rounds : of a clone's training; in those after the first it acts itself
    bends : candidates, of which the best on validation curves is taken: error of the tip that counts as much as a second
        difference of the commands, both as actions
    planning : of the expert that it is compared with
    """

    always: bool
    courses: int
    approach_steps: int
    average_window: int
    horizon: int
    memory_steps: int
    noise_mm: float
    rounds: int
    bends: tuple[float, ...]
    planning: Inversion

    def __post_init__(self) -> None:
        for name in ("courses", "average_window", "horizon", "memory_steps", "rounds"):
            if getattr(self, name) < 1:
                raise ConfigError(f"stage.motion.{name}={getattr(self, name)} must be at least 1")
        if not self.bends or min(self.bends) <= 0.0:
            raise ConfigError(f"stage.motion.bends={list(self.bends)}; expected one or more, all positive")
        for name in ("approach_steps", "noise_mm"):
            if getattr(self, name) < 0:
                raise ConfigError(f"stage.motion.{name}={getattr(self, name):g} must not be negative")


@dataclass
class _Episode:
    """One robot, what was asked of it, and, once the expert was asked, its plan."""

    run: Run
    requests: list[np.ndarray]
    plan: Plan | None = None
    shift: np.ndarray | None = None


class MovingBatch(Batch):
    """As ``Batch``, but each tip moves through a simulator and comes from rest.

    Parameters
    ----------
    route : from requests to readings of the tip
    plans : of courses (curve, phase, direction, length), shared by all batches on the same goals

    Raises
    ------
    ConfigError
        If the simulator is none that goes over many steps in one call.
    """

    def __init__(
        self, task: Task, space: Workspace, goals: Goals, size: int, route: Route, motion: Motion,
        plans: dict[tuple[int, ...], Plan],
    ) -> None:
        body = route.plant.simulator
        if not isinstance(body, FAST):
            raise ConfigError(
                f"training in motion needs simulator=rom or pcc, which are fast enough; not {type(body).__name__}"
            )
        self.approach, self.motion = motion.approach_steps, motion
        super().__init__(replace(task, horizon=motion.horizon), space, goals, size)
        self.observation_size = observation_size(motion.horizon, motion.memory_steps)
        self.expert_columns = np.arange(self.observation_size)
        self.differences = differences(motion.horizon, motion.memory_steps)
        self._route, self._plans, self._maps = route, plans, PressureToJoints(space.surrogate)
        self._episodes: list[_Episode] = [_Episode(None, [])] * size  # type: ignore[arg-type]
        self._length = np.zeros(size, dtype=int)
        self._past_tip, self._past_theta = np.zeros((2, size, motion.memory_steps, 3))
        self.scales = self.scales._replace(centre=np.zeros(3), position=1.0)  # of tips told as joints
        self._rng: np.random.Generator | None = None

    def start(
        self, which: np.ndarray, theta: np.ndarray, curve: np.ndarray, phase: np.ndarray, direction: np.ndarray,
        push: np.ndarray | None = None,
    ) -> None:
        """Start the episodes ``which`` from rest; ``theta`` is that of rest, the only one that a still robot can have."""
        self.curve[which], self.phase[which], self.direction[which] = curve, phase, direction
        self.elapsed[which], self.theta[which] = 0, self.space.rest
        self.push[which] = 0.0 if push is None else push
        self._length[which] = self.approach + self.goals.position.shape[1]
        for i in which:
            self._episodes[i] = _Episode(Run(self._route, self.push[i] if self.push[i].any() else None), [])
            self.tip[i] = self._read(self._episodes[i].run.tip)
        self._past_tip[which] = told_as_joints(self.space, self.tip[which])[:, None]
        self._past_theta[which] = self.theta[which, None]

    def start_random(self, which: np.ndarray, rng: np.random.Generator) -> None:
        """Start the episodes ``which`` on random courses under random forces; readings are noisy from now on."""
        self._rng, count = rng, len(which)
        push = self.task.disturbance_n * rng.uniform(-1.0, 1.0, (count, 3))
        self.start(
            which, np.tile(self.space.rest, (count, 1)), rng.integers(len(self.goals.position), size=count),
            np.zeros(count, dtype=int), np.ones(count, dtype=int), push,
        )  # fmt: skip
        self._length[which] = self.episode_steps + self.motion.horizon

    def spread(self, rng: np.random.Generator) -> None:
        """Leave the clocks: an episode is planned from its beginning."""

    def observation(self) -> np.ndarray:
        """Return what the controllers see, (B, k): the present, the next targets, and the past, latest first."""
        tip, (position, force) = told_as_joints(self.space, self.tip), self.targets()
        seen = observe(self.scales, tip, self.theta, self.contact_force, told_as_joints(self.space, position), force)
        return np.hstack([seen, remembered(self.scales, self._past_tip, self._past_theta)])

    def expert_action(self) -> np.ndarray:
        """Return the planned actions (B, 3), corrected for what commands and forces have done to the tip."""
        request = np.stack([self._planned(i) for i in range(self.size)])
        return action_of(self._maps.joints(request), self.scales.joint_low, self.scales.joint_high)

    def step(self, action: np.ndarray) -> Step:
        """Go on by one period under ``action`` (B, 3) and judge the tips at its end against the targets it was for."""
        position, force = (target[:, 0] for target in self.targets())
        for past, now in ((self._past_tip, told_as_joints(self.space, self.tip)), (self._past_theta, self.theta)):
            past[:, 1:] = past[:, :-1].copy()
            past[:, 0] = now
        requests = self._maps.pressure(command_of(action, self.scales.joint_low, self.scales.joint_high))
        # what pressures in range can ask for: a policy that remembers more would have to take it back first
        self.theta = self._maps.joints(requests)
        reached = np.empty((self.size, 3))
        for i, (episode, request) in enumerate(zip(self._episodes, requests, strict=True)):
            reached[i] = episode.run.advance(request)
            episode.requests.append(request)
            self.tip[i] = self._read(reached[i])
        self.elapsed += 1
        position_error, force_error = self.task.position_error(reached, position, self.plane), np.abs(force)
        return Step(self.observation(), self.task.reward(position_error, force_error), position_error, force_error)

    def _read(self, tip: np.ndarray) -> np.ndarray:
        """Return the reading (3,) m of a tip: with noise while training."""
        return tip if self._rng is None else tip + 1e-3 * self.motion.noise_mm * self._rng.standard_normal(3)

    def _planned(self, i: int) -> np.ndarray:
        """Return the expert's request (n,) Pa in episode ``i``."""
        episode, robot = self._episodes[i], self._route.robot
        if episode.plan is None:
            self._prepare(i)
        assert episode.plan is not None and episode.shift is not None
        sent = np.array(episode.requests).reshape(-1, robot.chambers)
        shift = episode.shift[len(sent) : len(sent) + self.motion.horizon]
        wanted = episode.plan.renewed(sent, shift, self.motion.planning.bend_weight)[0]
        return np.clip(wanted, robot.pressure_min_pa, robot.pressure_max_pa)

    def _prepare(self, i: int) -> None:
        """Plan the course of episode ``i``, and find what its hidden force does to it."""
        key = tuple(int(part[i]) for part in (self.curve, self.phase, self.direction, self._length))
        if key not in self._plans:
            curve, phase, direction, length = key
            at = (phase + direction * np.arange(length - self.approach)) % self.goals.position.shape[1]
            target, force = self.goals.position[curve, at], self.goals.force[curve, at]
            static = self._maps.pressure(self.task.expert(target, force, self.space))
            self._plans[key] = plan(self._route, target, static, self.approach, self.motion.planning)
        prepared, episode = self._plans[key], self._episodes[i]
        episode.plan, episode.shift = prepared, np.zeros_like(prepared.predicted)
        if self.push[i].any():
            episode.shift = self._route.predict(prepared.request, self.push[i]) - prepared.predicted


def differences(horizon: int, memory: int) -> np.ndarray:
    """Return (k, m) that takes observations to targets and past tips less the tip, past commands less the last one."""
    targets = [7 + 4 * i for i in range(horizon)]
    past = [observation_size(horizon) + 6 * j for j in range(memory)]
    parts = []
    for first, now in [(at, TIP) for at in targets + past] + [(at + 3, THETA) for at in past]:
        part = np.zeros((observation_size(horizon, memory), 3))
        part[first : first + 3], part[now] = np.eye(3), -np.eye(3)
        parts.append(part)
    return np.hstack(parts)


def cornered(goals: Goals, rng: np.random.Generator) -> Goals:
    """Return the goals with every other curve cut to a polygon: random curves are smooth, what is asked later may not be."""
    position, lap = goals.position.copy(), goals.position.shape[1]
    for curve in position[1::2]:
        nodes = np.cumsum(rng.integers(*CORNER_STEPS, size=lap))
        nodes = np.concatenate([[0], nodes[nodes < lap], [lap]])
        at = nodes % lap
        curve[:] = np.stack([np.interp(np.arange(lap), nodes, curve[at, k]) for k in range(3)], axis=1)
    return Goals(position, goals.force)
