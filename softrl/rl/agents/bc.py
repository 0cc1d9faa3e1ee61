"""Behavioural cloning of the model-based expert."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.sac.policies import SACPolicy

from softrl.core.progress import progress
from softrl.rl.actor import act_scaled
from softrl.rl.agents.agent import Agent, Best, Lesson, Practice, actor_from
from softrl.rl.vector_env import TwinVecEnv

JUDGEMENTS = 10


@dataclass(frozen=True)
class Bc(Agent):
    """Supervised training of the actor of SB3's SAC policy on what the expert would do.

    Attributes
    ----------
    hidden : width of the two hidden layers
    envs, steps : episodes side by side, and their steps in each round of data
    rounds : of data; from the second on the clone acts and the expert corrects it (DAgger)
    epochs : of training after each round;  batch_size, learning_rate : of Adam, falling linearly
    exploration : spread of the noise on actions while data is taken, so that the clone learns to come back
    """

    name: ClassVar[str] = "bc"

    hidden: int
    envs: int
    steps: int
    rounds: int
    epochs: int
    batch_size: int
    learning_rate: float
    exploration: float

    def __post_init__(self) -> None:
        self._require_positive("hidden", "envs", "steps", "rounds", "epochs", "batch_size", "learning_rate")

    def train(self, practice: Practice, seed: int) -> Lesson:
        """Return the clone with the best validation reward."""
        env = practice.make(self.envs, seed)
        model = SAC("MlpPolicy", env, policy_kwargs=policy_layers(self.hidden), buffer_size=1, seed=seed, device="cpu")
        return clone(self, model.policy, env, practice, seed)


def policy_layers(hidden: int) -> dict[str, object]:
    """Return the shape of the networks: tanh, because the map to be learnt is smooth."""
    return {"net_arch": [hidden, hidden], "activation_fn": torch.nn.Tanh}


def mean_layers(policy: SACPolicy) -> list[torch.nn.Module]:
    """Return the layers of SAC's deterministic actor in order."""
    return [*policy.actor.latent_pi, policy.actor.mu]


def clone(bc: Bc, policy: SACPolicy, env: TwinVecEnv, practice: Practice, seed: int) -> Lesson:
    """Train the actor of ``policy`` in place on the expert's actions; leave its best weights in it and return them."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    network = torch.nn.Sequential(*mean_layers(policy))
    optimiser = torch.optim.Adam(network.parameters(), lr=bc.learning_rate)
    total = bc.rounds * bc.epochs
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda epoch: 0.01 + 0.99 * (1.0 - epoch / total) ** 2)
    best, seen, wanted = Best(practice.judge), [], []
    for epoch in progress(range(total), "behavioural cloning"):
        if epoch % bc.epochs == 0:
            observations, actions = _collect(bc, network if epoch else None, env, rng)
            seen.append(observations)
            wanted.append(actions)
            x, y = torch.tensor(np.concatenate(seen)), torch.tensor(np.concatenate(wanted))
        for rows in torch.tensor(rng.permutation(len(x))).split(bc.batch_size):
            optimiser.zero_grad()
            (torch.tanh(network(x[rows])) - y[rows]).pow(2).mean().backward()
            optimiser.step()
        schedule.step()
        if (epoch + 1) % max(1, total // JUDGEMENTS) == 0 or epoch + 1 == total:
            best.consider(actor_from(network, "tanh"), epoch + 1)
    lesson = best.lesson()
    for i, layer in enumerate(m for m in network if isinstance(m, torch.nn.Linear)):
        layer.weight.data = torch.tensor(lesson.actor.weights[f"weight_{i}"])
        layer.bias.data = torch.tensor(lesson.actor.weights[f"bias_{i}"])
    return lesson


def _collect(
    bc: Bc, network: torch.nn.Sequential | None, env: TwinVecEnv, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return observations (rows, k) and the expert's actions (rows, 3) there; the clone acts once there is one."""
    observation = env.reset()
    seen, wanted = [], []
    for _ in range(bc.steps):
        action = env.batch.expert_action()
        seen.append(observation)
        wanted.append(action)
        taken = action if network is None else act_scaled(actor_from(network, "tanh"), observation)
        env.step_async(np.clip(taken + bc.exploration * rng.normal(size=taken.shape), -1.0, 1.0))
        observation = env.step_wait()[0]
    return np.concatenate(seen).astype(np.float32), np.concatenate(wanted).astype(np.float32)
