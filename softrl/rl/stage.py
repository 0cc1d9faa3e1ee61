"""Reinforcement learning on the surrogate's twin, or on a simulator in motion with its effects: a task, an agent, a policy."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.core.tracking import Tracker
from softrl.effects.chain import EffectChain, Plant
from softrl.rl.actor import Actor, act_scaled
from softrl.rl.agents.agent import Agent, Lesson, Practice
from softrl.rl.batch import Batch
from softrl.rl.evaluate import (
    Controller,
    Evaluation,
    corner_pushes,
    expert,
    lap_all,
    open_loop,
    rest,
    static_expert,
)
from softrl.rl.figures import draw_history, draw_laps, draw_reward
from softrl.rl.inversion import Route
from softrl.rl.moving import Motion, MovingBatch, cornered
from softrl.rl.tasks.task import Goals, Task
from softrl.rl.vector_env import TwinVecEnv
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
NEAR_MM = 0.3  # the error on unseen curves whose time is told
World = Callable[[Goals, int], Batch]


@dataclass(frozen=True)
class Config:
    """Training and evaluation of one policy.

    Attributes
    ----------
    training_curves, validation_curves : random curves; the best actor is chosen on the latter
    episodes : laps over each evaluation curve, from other starts and both ways
    motion : how training goes in a simulator in motion: where it has effects, or if asked for
    """

    training_curves: int
    validation_curves: int
    episodes: int
    motion: Motion
    seed: int

    def __post_init__(self) -> None:
        for name in ("training_curves", "validation_curves", "episodes"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name)} must be positive")


def run(
    config: Config,
    robot: Robot,
    surrogate: Surrogate,
    task: Task,
    agent: Agent,
    simulator: Simulator,
    effects: EffectChain,
    *,
    tracker: Tracker,
) -> Policy:
    """Return the agent's best policy on random curves, with its errors on curves it never saw beside baselines.

    Without effects it learns on the surrogate's twin, which is always where its command leads to; with ``effects``, or a
    ``simulator`` whose parameters a diagnosis found, in that simulator, in motion.
    """
    surrogate.require_robot(robot.name, robot.gravity_m_s2)
    rng = np.random.default_rng(config.seed)
    space = Workspace(surrogate)
    task.check_forces(robot.tip_force_max_n, space)
    evaluation = {curve: task.evaluation_goals(curve, space) for curve in task.curves}  # one out of reach is told at once
    moving = effects.corrected or config.motion.always
    world = _moving(config.motion, task, space, Plant(simulator, effects)) if moving else partial(Batch, task, space)
    training = _training(config, task, space, moving, rng)
    validation = task.training_goals(config.validation_curves, space, rng)
    clock = _Clock()
    practice = _practice(world, training, validation, clock, config.motion if moving else None)
    lesson = agent.train(practice, config.seed)
    metrics = clock.metrics() | _report(config, world, evaluation, lesson, tracker)
    for name, value in metrics.items():
        tracker.metric(name, value)
    return _policy(robot, task, agent, world(training, 1), lesson.actor, metrics, effects if moving else None)


def _moving(motion: Motion, task: Task, space: Workspace, plant: Plant) -> World:
    """Return the simulator in motion as a place to learn in."""
    if task.plane(space) is not None:
        raise ConfigError(f"stage=rl learns in motion for task=track only, not task={task.name}; leave out effect=")
    chain = plant.chain
    log.info("training in motion, effects: %s", ", ".join(e.name() for e in chain.effects) or "none")
    route = Route(chain.robot, plant, task.step_s, motion.planning.dt_s, motion.average_window, lambda position: position)
    plans: dict[int, dict[tuple[int, ...], Any]] = {}
    return lambda goals, size: MovingBatch(task, space, goals, size, route, motion, plans.setdefault(id(goals), {}))


def _training(config: Config, task: Task, space: Workspace, moving: bool, rng: np.random.Generator) -> Goals:
    if not moving:
        return task.training_goals(config.training_curves, space, rng)
    return cornered(task.training_goals(config.motion.courses, space, rng), rng)


class _Clock:
    """Processor time of training, and that at which the error on unseen curves first was small."""

    def __init__(self) -> None:
        self._began, self._near_s = time.process_time(), float("nan")

    def now(self) -> float:
        """Return the time so far in s."""
        return time.process_time() - self._began

    def judged(self, rmse_m: float) -> None:
        """Take in an error on unseen curves."""
        if np.isnan(self._near_s) and 1e3 * rmse_m < NEAR_MM:
            self._near_s = self.now()

    def metrics(self) -> dict[str, float]:
        """Return the time so far, and that to the small error if it was reached."""
        near = {} if np.isnan(self._near_s) else {"val/cpu_s_to_0_3_mm": self._near_s}
        return {"train_cpu_s": self.now()} | near


def _practice(world: World, training: Goals, validation: Goals, clock: _Clock, motion: Motion | None) -> Practice:
    def make(size: int, seed: int) -> TwinVecEnv:
        return TwinVecEnv(world(training, size), seed)

    def judge(actor: Actor) -> float:
        found = lap_all(controller_of(actor), world(validation, len(validation.force)))
        clock.judged(found.position_rmse)
        return found.reward

    return Practice(make, judge, motion.rounds, motion.bends) if motion else Practice(make, judge)


def controller_of(actor: Actor) -> Controller:
    """Return the actor as a controller of a batch."""
    return lambda batch: act_scaled(actor, batch.observation())


def _report(
    config: Config, world: World, evaluation: dict[str, Goals], lesson: Lesson, tracker: Tracker
) -> dict[str, float]:
    """Return the metrics after sending figures to ``tracker``."""
    metrics: dict[str, float] = {}
    laps: dict[str, Evaluation] = {}
    for curve, goals in evaluation.items():
        batch = world(goals, 1)
        extent = np.linalg.norm(goals.position[0] - batch.space.centre, axis=1).max()
        metrics[f"heldout/{curve}_radius_mm"] = 1e3 * float(extent)
        for label, controller in _controllers(lesson.actor, batch).items():
            # in motion the expert plans every lap: one must do
            episodes = 1 if label == "expert_" and isinstance(batch, MovingBatch) else config.episodes
            found = lap_all(controller, world(goals, episodes))
            metrics[f"heldout/{label}{curve}_position_rmse_mm"] = 1e3 * found.position_rmse
            metrics[f"heldout/{label}{curve}_reward"] = found.reward
            if batch.plane is not None:
                metrics[f"heldout/{label}{curve}_force_error_n"] = found.force_mae
                metrics[f"heldout/{label}{curve}_force_rmse_n"] = found.force_rmse
            if not label:
                laps[curve] = found
        metrics |= _under_load(config, world, lesson.actor, curve, goals)
    metrics["val/reward"] = float(np.nanmax([reward for _, reward in lesson.history]))
    for step, reward in lesson.history:
        tracker.metric("val/reward", reward, step)
    tracker.figure("evaluation", draw_laps(laps, batch.plane))
    tracker.figure("reward", draw_reward(batch.task))
    tracker.figure("training", draw_history(lesson.history))
    return metrics


def _controllers(actor: Actor, batch: Batch) -> dict[str, Controller]:
    """Return the policy and what it is compared with; in motion also the inverse that takes the robot to stand still."""
    found: dict[str, Controller] = {"": controller_of(actor), "expert_": expert, "rest_": rest}
    return found | {"static_": static_expert} if isinstance(batch, MovingBatch) else found


def _under_load(config: Config, world: World, actor: Actor, curve: str, goals: Goals) -> dict[str, float]:
    """Return the errors under hidden forces on the tip, of the policy, the expert, and an inverse that is blind to them."""
    batch = world(goals, 1)
    if batch.task.disturbance_n == 0.0:
        return {}
    push = corner_pushes(batch.task.disturbance_n, config.episodes)
    controllers: dict[str, Controller] = {"": controller_of(actor), "open_loop_": open_loop}
    if not isinstance(batch, MovingBatch):
        controllers["expert_"] = expert
    return {
        f"heldout/{label}loaded_{curve}_position_rmse_mm": 1e3
        * lap_all(controller, world(goals, config.episodes), push).position_rmse
        for label, controller in controllers.items()
    }


def _policy(
    robot: Robot, task: Task, agent: Agent, batch: Batch, actor: Actor, metrics: dict[str, float],
    effects: EffectChain | None,
) -> Policy:
    scales = batch.scales
    motion = batch.motion if isinstance(batch, MovingBatch) else None
    return Policy(
        weights=actor.weights,
        activation=actor.activation,
        squash=actor.squash,
        horizon=batch.task.horizon,
        position_centre=scales.centre,
        position_scale=scales.position,
        force_scale=scales.force,
        joint_low=scales.joint_low,
        joint_high=scales.joint_high,
        task_name=task.name,
        task=batch.task.record(),
        agent_name=agent.name,
        step_s=task.step_s,
        metrics=metrics,
        robot_name=robot.name,
        told_as="joints" if motion else "position",
        memory=motion.memory_steps if motion else 0,
        average_window=motion.average_window if motion else 1,
        effects=tuple(effect.name() for effect in effects.effects) if effects else (),
        retuned=effects.retuned if effects else False,
    )
