"""What an agent gets and gives; its numbers come from conf/agent."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.logger import Logger

from softrl.core.errors import ConfigError, SolverError
from softrl.rl.actor import Actor
from softrl.rl.vector_env import TwinVecEnv

log = logging.getLogger(__name__)


class Practice(NamedTuple):
    """Where an agent trains: ``make(size, seed)`` gives episodes, ``judge`` the validation reward of an actor.

    ``rounds`` is how often a clone in motion is let act and learns from it.
    ``bends`` are candidates for what a second difference of the commands weighs in motion, see ``prediction.answer``.
    """

    make: Callable[[int, int], TwinVecEnv]
    judge: Callable[[Actor], float]
    rounds: int = 1
    bends: tuple[float, ...] = ()


class Lesson(NamedTuple):
    """The best actor by validation reward, and (environment steps or epochs, validation reward) on the way."""

    actor: Actor
    history: list[tuple[int, float]]


@dataclass(frozen=True)
class Agent(ABC):
    """Base of all agents."""

    name: ClassVar[str]

    @abstractmethod
    def train(self, practice: Practice, seed: int) -> Lesson:
        """Return the best actor found."""

    def _require_positive(self, *names: str) -> None:
        for name in names:
            if getattr(self, name) <= 0:
                raise ConfigError(f"agent.{name}={getattr(self, name):g} must be positive")

    def _require_share(self, *names: str) -> None:
        for name in names:
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ConfigError(f"agent.{name}={getattr(self, name):g}; expected a share above 0 and at most 1")


def learn_or_keep(model: Any, steps: int, judge: Any, best: "Best") -> None:
    """Train an agent of SB3, and judge it at the end; one that diverges leaves the best actor so far.

    Raises
    ------
    SolverError
        If it diverged before any actor was judged.
    """
    model.set_logger(Logger(folder=None, output_formats=[]))  # or it leaves a folder of its own among temporary files
    try:
        model.learn(steps, callback=judge)
    except ValueError as error:  # how torch's distributions refuse what is not finite
        if not best.history:
            raise SolverError(
                f"training diverged after {model.num_timesteps} of {steps} steps, before any validation: lower "
                "agent.learning_rate, or validate more often with agent.judge_every"
            ) from error
        log.warning("training diverged after %d of %d steps; the best actor so far is kept", model.num_timesteps, steps)
        return
    best.consider(judge.actor(), steps)


class Best:
    """Keeps the actor with the highest validation reward."""

    def __init__(self, judge: Callable[[Actor], float]) -> None:
        self._judge, self._reward = judge, -np.inf
        self._actor: Actor | None = None
        self.history: list[tuple[int, float]] = []

    def consider(self, actor: Actor, step: int) -> float:
        """Judge ``actor`` after ``step``, keep it if it is the best so far, and return its reward."""
        reward = self._judge(actor)
        self.history.append((step, reward))
        if reward >= self._reward:  # never true of nan; of equal ones the last has learnt longest
            self._reward, self._actor = reward, actor
        return reward

    def lesson(self) -> Lesson:
        """Return the best actor and the history."""
        assert self._actor is not None
        return Lesson(self._actor, self.history)


def actor_from(layers: Iterable[torch.nn.Module], squash: str) -> Actor:
    """Return the arrays of a torch stack of linear layers."""
    weights: dict[str, np.ndarray] = {}
    activation = "relu"
    for module in layers:
        if isinstance(module, torch.nn.Linear):
            i = len(weights) // 2
            weights[f"weight_{i}"] = module.weight.detach().numpy().copy()
            weights[f"bias_{i}"] = module.bias.detach().numpy().copy()
        elif isinstance(module, torch.nn.Tanh):
            activation = "tanh"
    return Actor(weights, activation, squash)


def decaying(rate: float) -> Callable[[float], float]:
    """Return a learning rate that falls linearly to a twentieth; its argument is the share of training left."""
    return lambda left: rate * (0.05 + 0.95 * left)
