"""Reinforcement learning on the surrogate's twin: a task, an agent, a policy."""

import logging
from dataclasses import dataclass

import numpy as np

from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.tracking import Tracker
from softrl.rl.actor import Actor, act_scaled
from softrl.rl.agents.agent import Agent, Lesson, Practice
from softrl.rl.batch import Batch, scales_of
from softrl.rl.evaluate import Controller, Evaluation, corner_pushes, evaluate, expert, open_loop, rest
from softrl.rl.figures import draw_history, draw_laps, draw_reward
from softrl.rl.tasks.task import Goals, Task
from softrl.rl.vector_env import TwinVecEnv
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Config:
    """Training and evaluation of one policy.

    Attributes
    ----------
    training_curves, validation_curves : random curves; the best actor is chosen on the latter
    episodes : laps over each evaluation curve, from other starts and both ways
    """

    training_curves: int
    validation_curves: int
    episodes: int
    seed: int

    def __post_init__(self) -> None:
        for name in ("training_curves", "validation_curves", "episodes"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name)} must be positive")


def run(config: Config, robot: Robot, surrogate: Surrogate, task: Task, agent: Agent, *, tracker: Tracker) -> Policy:
    """Return the agent's best policy on random curves, with its errors on curves it never saw beside two baselines."""
    if surrogate.robot_name != robot.name:
        raise ArtifactError(
            f"the surrogate is of robot {surrogate.robot_name}, but robot={robot.name}; rerun stage=surrogate"
        )
    rng = np.random.default_rng(config.seed)
    space = Workspace(surrogate)
    evaluation = {curve: task.evaluation_goals(curve, space) for curve in task.curves}  # one out of reach is told at once
    training = task.training_goals(config.training_curves, space, rng)
    validation = task.training_goals(config.validation_curves, space, rng)
    lesson = agent.train(_practice(task, space, training, validation), config.seed)
    metrics = _report(config, task, space, evaluation, lesson, tracker)
    return _policy(robot, task, agent, space, lesson.actor, metrics)


def _practice(task: Task, space: Workspace, training: Goals, validation: Goals) -> Practice:
    def make(size: int, seed: int) -> TwinVecEnv:
        return TwinVecEnv(Batch(task, space, training, size), seed)

    def judge(actor: Actor) -> float:
        return evaluate(controller_of(actor), task, space, validation, len(validation.force)).reward

    return Practice(make, judge)


def controller_of(actor: Actor) -> Controller:
    """Return the actor as a controller of a batch."""
    return lambda batch: act_scaled(actor, batch.observation())


def _report(
    config: Config, task: Task, space: Workspace, evaluation: dict[str, Goals], lesson: Lesson, tracker: Tracker
) -> dict[str, float]:
    """Return the metrics after sending them, and figures, to ``tracker``."""
    controllers = {"": controller_of(lesson.actor), "expert_": expert, "rest_": rest}
    metrics: dict[str, float] = {}
    laps: dict[str, Evaluation] = {}
    for curve, goals in evaluation.items():
        extent = np.linalg.norm(goals.position[0] - space.centre, axis=1).max()
        metrics[f"heldout/{curve}_radius_mm"] = 1e3 * float(extent)
        for label, controller in controllers.items():
            found = evaluate(controller, task, space, goals, config.episodes)
            metrics[f"heldout/{label}{curve}_position_rmse_mm"] = 1e3 * found.position_rmse
            metrics[f"heldout/{label}{curve}_reward"] = found.reward
            if task.plane(space) is not None:
                metrics[f"heldout/{label}{curve}_force_error_n"] = found.force_mae
            if not label:
                laps[curve] = found
        metrics |= _under_load(config, task, space, lesson.actor, curve, goals)
    metrics["val/reward"] = float(np.nanmax([reward for _, reward in lesson.history]))
    for step, reward in lesson.history:
        tracker.metric("val/reward", reward, step)
    for name, value in metrics.items():
        tracker.metric(name, value)
    tracker.figure("evaluation", draw_laps(laps, task.plane(space)))
    tracker.figure("reward", draw_reward(task))
    tracker.figure("training", draw_history(lesson.history))
    return metrics


def _under_load(
    config: Config, task: Task, space: Workspace, actor: Actor, curve: str, goals: Goals
) -> dict[str, float]:
    """Return the errors under hidden forces on the tip, of the policy, the expert, and an inverse that is blind to them."""
    if task.disturbance_n == 0.0:
        return {}
    push = corner_pushes(task.disturbance_n, config.episodes)
    controllers = {"": controller_of(actor), "expert_": expert, "open_loop_": open_loop}
    return {
        f"heldout/{label}loaded_{curve}_position_rmse_mm": 1e3
        * evaluate(controller, task, space, goals, config.episodes, push).position_rmse
        for label, controller in controllers.items()
    }


def _policy(
    robot: Robot, task: Task, agent: Agent, space: Workspace, actor: Actor, metrics: dict[str, float]
) -> Policy:
    scales = scales_of(task, space)
    return Policy(
        weights=actor.weights,
        activation=actor.activation,
        squash=actor.squash,
        horizon=task.horizon,
        position_centre=scales.centre,
        position_scale=scales.position,
        force_scale=scales.force,
        joint_low=scales.joint_low,
        joint_high=scales.joint_high,
        task_name=task.name,
        task=task.record(),
        agent_name=agent.name,
        step_s=task.step_s,
        metrics=metrics,
        robot_name=robot.name,
    )
