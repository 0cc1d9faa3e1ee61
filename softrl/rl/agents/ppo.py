"""Proximal policy optimisation of stable-baselines3."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from softrl.core.errors import ConfigError
from softrl.rl.actor import Actor
from softrl.rl.agents.agent import Agent, Best, Lesson, Practice, actor_from, decaying, learn_or_keep
from softrl.rl.agents.bc import policy_layers


@dataclass(frozen=True)
class Ppo(Agent):
    """PPO; the learning rate falls linearly.

    Attributes
    ----------
    hidden : width of the two hidden layers
    envs : episodes side by side;  steps : of all of them together
    rollout : steps of each episode between two updates;  epochs, batch_size, learning_rate, gamma : as in SB3
    log_std_start : of the exploration in actions
    judge_every : steps between two validations
    """

    name: ClassVar[str] = "ppo"

    hidden: int
    envs: int
    steps: int
    rollout: int
    epochs: int
    batch_size: int
    learning_rate: float
    gamma: float
    log_std_start: float
    judge_every: int

    def __post_init__(self) -> None:
        self._require_positive(
            "hidden", "envs", "steps", "rollout", "epochs", "batch_size", "learning_rate", "judge_every"
        )
        self._require_share("gamma")
        if min(self.batch_size, self.envs * self.rollout) < 2:
            raise ConfigError(
                f"agent.batch_size={self.batch_size}, envs={self.envs} times rollout={self.rollout}; expected 2 steps or more "
                "of both, whose advantages are compared"
            )

    def train(self, practice: Practice, seed: int) -> Lesson:
        """Return the actor with the best validation reward."""
        torch.set_num_threads(1)
        env = practice.make(self.envs, seed)
        model = PPO(
            "MlpPolicy", env, learning_rate=decaying(self.learning_rate), n_steps=self.rollout, batch_size=self.batch_size,
            n_epochs=self.epochs, gamma=self.gamma, seed=seed,
            policy_kwargs=policy_layers(self.hidden) | {"log_std_init": self.log_std_start}, device="cpu",
        )  # fmt: skip
        best = Best(practice.judge)
        judge = Judge(best, self.judge_every)
        learn_or_keep(model, self.steps, judge, best)
        return best.lesson()


class Judge(BaseCallback):
    """Validates the actor after updates."""

    def __init__(self, best: Best, every: int) -> None:
        super().__init__()
        self._best, self._every, self._next = best, every, every

    def actor(self) -> Actor:
        """Return the deterministic actor as it is now."""
        policy = self.model.policy
        return actor_from([*policy.mlp_extractor.policy_net, policy.action_net], "clip")

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self._next:
            self._next += self._every
            self._best.consider(self.actor(), self.num_timesteps)

    def _on_step(self) -> bool:
        return True
