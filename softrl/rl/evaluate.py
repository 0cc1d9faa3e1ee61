"""Deterministic evaluation on curves that training never saw."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrl.rl.batch import Batch, action_of
from softrl.rl.tasks.task import Goals, Task
from softrl.rl.workspace import Workspace

Controller = Callable[[Batch], np.ndarray]


class Evaluation(NamedTuple):
    """What a controller did on laps over one set of curves.

    Attributes
    ----------
    reward : mean per step
    position_rmse : m;  force_mae : N, mean absolute error;  force_rmse : N
    tip : (steps, episodes, 3) m;  target : (steps, episodes, 3) m
    contact_force, wanted_force : (steps, episodes) N
    """

    reward: float
    position_rmse: float
    force_mae: float
    force_rmse: float
    tip: np.ndarray
    target: np.ndarray
    contact_force: np.ndarray
    wanted_force: np.ndarray


def evaluate(
    controller: Controller, task: Task, space: Workspace, goals: Goals, episodes: int, push: np.ndarray | None = None
) -> Evaluation:
    """Return the errors over one lap per episode on the twin, see ``lap_all``."""
    return lap_all(controller, Batch(task, space, goals, episodes), push)


def lap_all(controller: Controller, batch: Batch, push: np.ndarray | None = None) -> Evaluation:
    """Return the errors over one lap per episode, starts spread over the curves, both directions, from rest each time.

    ``push`` (episodes, 3) N acts on the tips, hidden from the controller; none by default.
    """
    episodes, (curves, lap) = batch.size, batch.goals.force.shape
    number = np.arange(episodes)
    phase = (number // curves) * lap // max(1, -(-episodes // curves))
    direction = np.where(number % 2 == 0, 1, -1)
    batch.start(number, np.tile(batch.space.rest, (episodes, 1)), number % curves, phase, direction, push)
    rows = []
    for _ in range(batch.approach):
        batch.step(controller(batch))
    for _ in range(lap):
        position, force = batch.targets()
        step = batch.step(controller(batch))
        rows.append((step.reward, step.position_error, step.force_error, batch.tip.copy(), position[:, 0],
                     batch.contact_force.copy(), force[:, 0]))  # fmt: skip
    reward, near, firm, *traces = (np.stack(column) for column in zip(*rows, strict=True))
    rms_near, rms_firm = (float(np.sqrt(np.mean(error**2))) for error in (near, firm))
    return Evaluation(float(reward.mean()), rms_near, float(firm.mean()), rms_firm, *traces)


def expert(batch: Batch) -> np.ndarray:
    """Act as the model-based controller."""
    return batch.expert_action()


def open_loop(batch: Batch) -> np.ndarray:
    """Act as the model's inverse, blind to where the tip is."""
    position, force = batch.targets()
    theta = batch.task.expert(position[:, 0], force[:, 0], batch.space)
    return action_of(theta, batch.scales.joint_low, batch.scales.joint_high)


def static_expert(batch: Batch) -> np.ndarray:
    """Act as the expert of the twin, which answers to where the tip is and knows of no motion."""
    return Batch.expert_action(batch)


def corner_pushes(size: float, episodes: int) -> np.ndarray:
    """Return forces (episodes, 3) N of length ``size`` along the diagonals of a cube, in turn."""
    corners = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) / 3**0.5
    return size * corners[np.arange(episodes) % len(corners)]


def rest(batch: Batch) -> np.ndarray:
    """Hold the command of zero pressure."""
    theta = np.tile(batch.space.rest, (batch.size, 1))
    return action_of(theta, batch.scales.joint_low, batch.scales.joint_high)
