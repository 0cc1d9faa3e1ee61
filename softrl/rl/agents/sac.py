"""Soft actor-critic of stable-baselines3, from scratch or correcting a clone of the expert."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from softrl.core.errors import ConfigError
from softrl.rl.actor import Actor
from softrl.rl.agents.agent import Agent, Best, Lesson, Practice, actor_from, decaying, learn_or_keep
from softrl.rl.agents.bc import Bc, mean_layers, policy_layers
from softrl.rl.agents.correction import CorrectedVecEnv, corrected


@dataclass(frozen=True)
class Sac(Agent):
    """SAC; the learning rate falls linearly.

    Attributes
    ----------
    hidden : width of the two hidden layers of actor and critics
    envs : episodes side by side;  steps : of all of them together
    gradient_steps : per step of the batch;  batch_size, buffer_size, learning_rate, gamma, tau : as in SB3
    learning_starts : steps before the first gradient
    judge_every : steps between two validations
    start_from : a bc agent whose clone the actor corrects, or null
    correction, entropy : of what corrects a clone: its reach as a share of half the action range, and the weight of its
        entropy, which is learnt from scratch
    """

    name: ClassVar[str] = "sac"

    hidden: int
    envs: int
    steps: int
    gradient_steps: int
    batch_size: int
    buffer_size: int
    learning_rate: float
    learning_starts: int
    gamma: float
    tau: float
    judge_every: int
    start_from: Bc | None
    correction: float
    entropy: float

    def __post_init__(self) -> None:
        self._require_positive(
            "hidden", "envs", "steps", "gradient_steps", "batch_size", "buffer_size", "learning_rate", "judge_every"
        )
        self._require_share("gamma", "tau", "correction")
        if not 0 <= self.learning_starts < self.steps:
            raise ConfigError(
                f"agent.learning_starts={self.learning_starts}; expected 0 or more, and less than agent.steps={self.steps}"
            )
        if self.entropy < 0.0:
            raise ConfigError(f"agent.entropy={self.entropy:g} must not be negative")

    def train(self, practice: Practice, seed: int) -> Lesson:
        """Return the actor with the best validation reward."""
        torch.set_num_threads(1)
        best, start = Best(practice.judge), self._start(practice, seed)
        env: VecEnv = practice.make(self.envs, seed)
        if start is not None:
            best.consider(start, 0)
            env = CorrectedVecEnv(env, start, self.correction)
        model = SAC(
            "MlpPolicy", env, learning_rate=decaying(self.learning_rate), buffer_size=self.buffer_size,
            learning_starts=self.learning_starts, batch_size=self.batch_size, gamma=self.gamma, tau=self.tau,
            gradient_steps=self.gradient_steps, policy_kwargs=policy_layers(self.hidden), seed=seed, device="cpu",
            ent_coef="auto" if start is None else self.entropy,
        )  # fmt: skip
        judge = Judge(best, self.judge_every, lambda actor: self._whole(start, actor))
        learn_or_keep(model, self.steps, judge, best)
        return best.lesson()

    def _start(self, practice: Practice, seed: int) -> Actor | None:
        """Return the clone that is corrected, if any."""
        return None if self.start_from is None else self.start_from.train(practice, seed).actor

    def _whole(self, start: Actor | None, actor: Actor) -> Actor:
        """Return what acts in the world: ``actor`` itself, or ``start`` with its corrections."""
        return actor if start is None else corrected(start, actor, self.correction)


class Judge(BaseCallback):
    """Validates the actor now and then; ``whole`` says what acts when it does."""

    def __init__(self, best: Best, every: int, whole: Callable[[Actor], Actor]) -> None:
        super().__init__()
        self._best, self._every, self._next, self._whole = best, every, every, whole

    def actor(self) -> Actor:
        """Return the deterministic actor as it is now."""
        return self._whole(actor_from(mean_layers(self.model.policy), "tanh"))

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._next:
            self._next += self._every
            self._best.consider(self.actor(), self.num_timesteps)
        return True
