"""Learning to correct a clone: the agent's action is added to what the clone does, and both become one actor."""

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn, VecEnvWrapper

from softrl.rl.actor import Actor, outputs
from softrl.rl.vector_env import TwinVecEnv

CARRIED = 0.01  # scale at which a clone's answer passes a tanh layer: the cube of it is what tanh adds


class CorrectedVecEnv(VecEnvWrapper):
    """Episodes whose actions are those of ``actor``, clipped, plus ``reach`` times the ones that come in.

    Notes
    -----
    A clone is right to a thousandth of the action range. A critic over whole actions cannot see the peak of the reward
    there, which is some hundredths wide, and the first noisy gradients would cost the clone what it knows. Over
    corrections the peak is as wide as the range, and no correction is the clone.
    """

    def __init__(self, env: TwinVecEnv, actor: Actor, reach: float) -> None:
        super().__init__(env)
        self._actor, self._reach = actor, reach
        self._seen = np.zeros((env.num_envs, env.batch.observation_size))

    def reset(self) -> np.ndarray:
        """Start all episodes."""
        self._seen = self.venv.reset()
        return self._seen

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the corrected actions for ``step_wait``."""
        self.venv.step_async(np.clip(outputs(self._actor, self._seen) + self._reach * actions, -1.0, 1.0))

    def step_wait(self) -> VecEnvStepReturn:
        """Step all episodes."""
        found = self.venv.step_wait()
        self._seen = found[0]
        return found


def corrected(actor: Actor, correction: Actor, reach: float) -> Actor:
    """Return one actor that does what ``actor``, clipped, does plus ``reach`` times ``correction``, squashed by tanh.

    Both have tanh between the same number of layers; the sum is one layer more.
    """
    layers = len(actor.weights) // 2
    weights: dict[str, np.ndarray] = {}
    for i in range(layers):
        scale = CARRIED if i == layers - 1 else 1.0
        first, second = scale * actor.weights[f"weight_{i}"], correction.weights[f"weight_{i}"]
        weights[f"weight_{i}"] = np.vstack([first, second]) if i == 0 else _beside(first, second)
        weights[f"bias_{i}"] = np.concatenate([scale * actor.weights[f"bias_{i}"], correction.weights[f"bias_{i}"]])
    one = np.eye(3, dtype=np.float32)
    weights[f"weight_{layers}"] = np.hstack([one / CARRIED, reach * one]).astype(np.float32)
    weights[f"bias_{layers}"] = np.zeros(3, dtype=np.float32)
    return Actor(weights, "tanh", "clip")


def _beside(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return both matrices (out, in) on the diagonal of one."""
    (a, b), (c, d) = first.shape, second.shape
    found = np.zeros((a + c, b + d), dtype=np.float32)
    found[:a, :b], found[a:, b:] = first, second
    return found
