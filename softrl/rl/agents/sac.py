"""Soft actor-critic of stable-baselines3, from scratch or from a clone of the expert."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback

from softrl.rl.agents.agent import Agent, Best, Lesson, Practice, actor_from, decaying, learn_or_keep
from softrl.rl.agents.bc import Bc, clone, mean_layers, policy_layers


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
    start_from : a bc agent whose clone the actor starts from, or null
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

    def __post_init__(self) -> None:
        self._require_positive(
            "hidden", "envs", "steps", "gradient_steps", "batch_size", "buffer_size", "learning_rate", "judge_every"
        )
        self._require_share("gamma", "tau")

    def train(self, practice: Practice, seed: int) -> Lesson:
        """Return the actor with the best validation reward."""
        torch.set_num_threads(1)
        env = practice.make(self.envs, seed)
        model = SAC(
            "MlpPolicy", env, learning_rate=decaying(self.learning_rate), buffer_size=self.buffer_size,
            learning_starts=self.learning_starts, batch_size=self.batch_size, gamma=self.gamma, tau=self.tau,
            gradient_steps=self.gradient_steps, policy_kwargs=policy_layers(self.hidden), seed=seed, device="cpu",
        )  # fmt: skip
        best = Best(practice.judge)
        if self.start_from is not None:
            teacher = practice.make(self.start_from.envs, seed + 1)
            cloned = clone(self.start_from, mean_layers(model.policy), "tanh", teacher, practice, seed)
            best.consider(cloned.actor, 0)
            model.ent_coef_optimizer = None
            model.ent_coef_tensor = torch.tensor(START_ENTROPY)
            model.actor.log_std.weight.data.zero_()
            model.actor.log_std.bias.data.fill_(START_LOG_STD)
        judge = Judge(best, self.judge_every)
        learn_or_keep(model, self.steps, judge, best)
        return best.lesson()


START_ENTROPY, START_LOG_STD = 1e-4, -4.0  # a clone explores near itself only


class Judge(BaseCallback):
    """Validates the actor now and then."""

    def __init__(self, best: Best, every: int) -> None:
        super().__init__()
        self._best, self._every, self._next = best, every, every

    def actor(self):  # type: ignore[no-untyped-def]
        """Return the deterministic actor as it is now."""
        return actor_from(mean_layers(self.model.policy), "tanh")

    def _on_step(self) -> bool:
        if self.num_timesteps >= self._next:
            self._next += self._every
            self._best.consider(self.actor(), self.num_timesteps)
        return True
