"""A deterministic actor as plain arrays."""

from typing import NamedTuple

import numpy as np


class Actor(NamedTuple):
    """Layers ``weight_i`` (out, in), ``bias_i`` (out,), their activation and the last one's squash: see ``Policy``."""

    weights: dict[str, np.ndarray]
    activation: str
    squash: str


def act_scaled(actor: Actor, observation: np.ndarray) -> np.ndarray:
    """Return the actions (B, 3) in -1 .. 1 at scaled observations (B, k)."""
    answer = outputs(actor, observation)
    return np.tanh(answer) if actor.squash == "tanh" else np.clip(answer, -1.0, 1.0)


def outputs(actor: Actor, observation: np.ndarray) -> np.ndarray:
    """Return what the last layer says (B, 3) at scaled observations (B, k), before it is squashed."""
    layers = len(actor.weights) // 2
    hidden = np.asarray(observation, dtype=np.float32)
    for i in range(layers):
        hidden = hidden @ actor.weights[f"weight_{i}"].T + actor.weights[f"bias_{i}"]
        if i < layers - 1:
            hidden = np.tanh(hidden) if actor.activation == "tanh" else np.maximum(hidden, 0.0)
    return hidden
