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
    layers = len(actor.weights) // 2
    hidden = np.asarray(observation, dtype=np.float32)
    for i in range(layers):
        hidden = hidden @ actor.weights[f"weight_{i}"].T + actor.weights[f"bias_{i}"]
        if i < layers - 1:
            hidden = np.tanh(hidden) if actor.activation == "tanh" else np.maximum(hidden, 0.0)
    return np.tanh(hidden) if actor.squash == "tanh" else np.clip(hidden, -1.0, 1.0)
