"""Behavioural cloning of the model-based expert; in motion the inverse of what follows from what is seen."""

import logging
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.sac.policies import SACPolicy

from softrl.core.errors import ConfigError
from softrl.core.whitening import Whitener
from softrl.rl.actor import Actor, act_scaled
from softrl.rl.agents.agent import Agent, Best, Lesson, Practice, actor_from
from softrl.rl.evaluate import static_expert
from softrl.rl.prediction import Trace, answer, predict
from softrl.rl.vector_env import TwinVecEnv
from softrl.surrogate.mlp import train_network

log = logging.getLogger(__name__)
CARRIERS = 3  # units that pass the linear part of the map through both tanh layers, one per action
CARRIED = 0.02  # scale at which they do it: the cube of it is what tanh adds


@dataclass(frozen=True)
class Bc(Agent):
    """Supervised training of the actor of SB3's PPO policy on what the expert would do.

    Attributes
    ----------
    hidden : width of the two hidden layers
    envs, steps : episodes side by side, and their steps while data is taken
    iterations : of L-BFGS
    exploration : spread of the noise on the expert's actions while data is taken, so that the clone learns to come back
    """

    name: ClassVar[str] = "bc"

    hidden: int
    envs: int
    steps: int
    iterations: int
    exploration: float

    def __post_init__(self) -> None:
        self._require_positive("envs", "steps", "iterations")
        if self.envs * self.steps < 2:
            raise ConfigError(f"agent.envs={self.envs} times steps={self.steps}; expected 2 steps or more to learn from")
        if self.hidden <= CARRIERS:
            raise ConfigError(f"agent.hidden={self.hidden}; expected more than {CARRIERS}")

    def train(self, practice: Practice, seed: int) -> Lesson:
        """Return the clone."""
        env = practice.make(self.envs, seed)
        model = PPO("MlpPolicy", env, n_steps=2, policy_kwargs=policy_layers(self.hidden), seed=seed, device="cpu")
        return clone(self, clipped_layers(model.policy), env, practice, seed)


def policy_layers(hidden: int) -> dict[str, object]:
    """Return the shape of the networks: tanh, because the map to be learnt is smooth."""
    return {"net_arch": [hidden, hidden], "activation_fn": torch.nn.Tanh}


def mean_layers(policy: SACPolicy) -> list[torch.nn.Module]:
    """Return the layers of SAC's deterministic actor in order; tanh squashes what comes out."""
    return [*policy.actor.latent_pi, policy.actor.mu]


def clipped_layers(policy: ActorCriticPolicy) -> list[torch.nn.Module]:
    """Return the layers of PPO's deterministic actor in order; what comes out is clipped."""
    return [*policy.mlp_extractor.policy_net, policy.action_net]


def clone(bc: Bc, layers: list[torch.nn.Module], env: TwinVecEnv, practice: Practice, seed: int) -> Lesson:
    """Put a clone of the expert into the ``layers`` of an actor, in place, and return it with the untrained one's reward.

    Notes
    -----
    The map from targets to commands is almost linear and wanted to a thousandth. A network with a linear path reaches
    that by L-BFGS in double precision where SB3's own shape, trained from its random start, stays ten times above; it is
    then folded into SB3's shape, the linear path carried by three units in the linear range of tanh. It sees the
    columns that the expert looks at, or these whitened, because friction goes by where the target lies from the tip, a small
    difference of both; the others get no weight. A robot in motion is another matter, see ``_in_motion``.
    """
    best = Best(practice.judge)
    best.consider(actor_from(layers, "clip"), 0)
    rng = np.random.default_rng(seed)
    if env.batch.differences is not None:
        _in_motion(bc, layers, env, practice, best, rng)
    else:
        _fit(bc, layers, env, _collect(bc, env, rng), seed, best)
    return best.lesson()


def _fit(
    bc: Bc, layers: list[torch.nn.Module], env: TwinVecEnv, rows: tuple[np.ndarray, np.ndarray], seed: int, best: Best
) -> None:
    """Fit the ``layers`` to observations (rows, k) and actions (rows, 3).

    Where nothing sticks a map of whitened columns is the worse one, so both are tried and the unseen curves choose.
    """
    observation, wanted = rows
    columns = env.batch.expert_columns
    columns = columns[np.ptp(observation[:, columns], axis=0) > 0.0]
    found = []
    for whitener in (Whitener.scaling(observation[:, columns]), Whitener.fit(observation[:, columns])):
        fitted = train_network(whitener.whiten(observation[:, columns]), wanted, bc.hidden - CARRIERS, bc.iterations, seed)
        plain = _fold(_of_observations(fitted, whitener, columns, observation.shape[1]))
        _put(layers, plain)
        found.append((best.consider(actor_from(layers, "clip"), bc.iterations), plain))
    _put(layers, max(found, key=lambda trial: np.nan_to_num(trial[0], nan=-np.inf))[1])


def _in_motion(
    bc: Bc, layers: list[torch.nn.Module], env: TwinVecEnv, practice: Practice, best: Best, rng: np.random.Generator
) -> None:
    """Put actors into the ``layers`` that lead the tips to come to the targets, and let ``best`` choose.

    Notes
    -----
    Where the plant has a memory the expert answers to what it alone knows, and through the moving average it rings: a clone
    had six times the errors of a plan. What is learnt is instead how the tip follows from what a policy sees and from
    the commands to come; its inverse is the actor (``prediction``). It is fitted first to what happens under the inverse that
    takes the robot to stand still, then to what the best actor so far does.
    """
    differences, traces, actor = env.batch.differences, list[Trace](), None
    assert differences is not None
    for number in range(practice.rounds):
        traces.append(_act(bc, env, actor, rng))
        found = predict(traces, differences, env.batch.task.horizon)
        log.info("round %d: the next tips are told to %s %% of the joints", number + 1, np.round(50.0 * found.left, 2))
        for bend in practice.bends:
            _put(layers, _fold(_linear(answer(found, differences, bend), bc.hidden - CARRIERS)))
            log.info("bend %g: reward %.4f", bend, best.consider(actor_from(layers, "clip"), number + 1))
        actor = best.lesson().actor


def _act(bc: Bc, env: TwinVecEnv, actor: Actor | None, rng: np.random.Generator) -> Trace:
    """Return what happens under ``actor``, or the static inverse, with noise on the actions."""
    observation, seen, elapsed = env.reset(), [], []
    for _ in range(bc.steps):
        seen.append(observation.astype(float))
        elapsed.append(env.batch.elapsed.copy())
        taken = static_expert(env.batch) if actor is None else act_scaled(actor, observation)
        env.step_async(np.clip(taken + bc.exploration * rng.normal(size=taken.shape), -1.0, 1.0))
        observation = env.step_wait()[0]
    return Trace(np.stack(seen), np.stack(elapsed))


def _linear(skip: np.ndarray, hidden: int) -> dict[str, np.ndarray]:
    """Return the network with a linear path ``skip`` (k, 3) whose tanh part is idle."""
    none = np.zeros(hidden)
    return {
        "skip": skip, "weight_0": np.zeros((len(skip), hidden)), "bias_0": none, "weight_1": np.zeros((hidden, hidden)),
        "bias_1": none, "weight_2": np.zeros((hidden, 3)), "bias_2": np.zeros(3),
    }  # fmt: skip


def _put(layers: list[torch.nn.Module], plain: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Put weight (out, in) and bias (out,) of plain layers into those of a network."""
    linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
    for layer, (weight, bias) in zip(linear, plain, strict=True):
        layer.weight.data = torch.tensor(weight, dtype=torch.float32)
        layer.bias.data = torch.tensor(bias, dtype=torch.float32)


def _of_observations(
    weights: dict[str, np.ndarray], whitener: Whitener, columns: np.ndarray, size: int
) -> dict[str, np.ndarray]:
    """Return the network that reads whole observations (size,) as ``weights`` read their whitened ``columns``."""
    w = dict(weights)
    for name, bias in (("skip", f"bias_{len(w) // 2 - 1}"), ("weight_0", "bias_0")):
        by_column = whitener.turn @ weights[name]
        w[bias] = w[bias] - whitener.mean @ by_column
        w[name] = np.zeros((size, by_column.shape[1]))
        w[name][columns] = by_column
    return w


def _fold(w: dict[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return weight (out, in) and bias (out,) of three plain layers that do what a network with a linear path does."""
    hidden = len(w["bias_0"])
    first = np.vstack([CARRIED * w["skip"].T, w["weight_0"].T])
    second = np.zeros((hidden + CARRIERS, hidden + CARRIERS))
    second[:CARRIERS, :CARRIERS] = np.eye(CARRIERS)
    second[CARRIERS:, CARRIERS:] = w["weight_1"].T
    last = np.hstack([np.eye(CARRIERS) / CARRIED, w["weight_2"].T])
    none = np.zeros(CARRIERS)
    return [
        (first, np.concatenate([none, w["bias_0"]])), (second, np.concatenate([none, w["bias_1"]])), (last, w["bias_2"]),
    ]  # fmt: skip


def _collect(bc: Bc, env: TwinVecEnv, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return observations (rows, k) and the expert's actions (rows, 3) there, states disturbed by noisy actions."""
    observation = env.reset()
    seen, wanted = [], []
    for _ in range(bc.steps):
        action = env.batch.expert_action()
        seen.append(observation)
        wanted.append(action)
        env.step_async(np.clip(action + bc.exploration * rng.normal(size=action.shape), -1.0, 1.0))
        observation = env.step_wait()[0]
    return np.concatenate(seen).astype(float), np.concatenate(wanted)
