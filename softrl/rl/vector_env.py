"""The batch as a vectorised environment of stable-baselines3: one NumPy call steps all episodes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from softrl.rl.batch import Batch
from softrl.rl.env import spaces_of


class TwinVecEnv(VecEnv):
    """Episodes of one batch, each started anew when its time is over."""

    def __init__(self, batch: Batch, seed: int) -> None:
        super().__init__(batch.size, *spaces_of(batch))
        self.batch = batch
        self._rng = np.random.default_rng(seed)
        self._action = np.zeros((batch.size, 3))
        self._return = np.zeros(batch.size)

    def reset(self) -> np.ndarray:
        """Start all episodes."""
        self.batch.start_random(np.arange(self.num_envs), self._rng)
        self.batch.spread(self._rng)
        self._return[:] = 0.0
        return self.batch.observation()

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for ``step_wait``."""
        self._action = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Step all episodes; one that ends by time says so, so that its value is bootstrapped."""
        step = self.batch.step(self._action)
        self._return += step.reward
        done = self.batch.elapsed >= self.batch.episode_steps
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observation = step.observation
        if done.any():
            ended = np.flatnonzero(done)
            for i in ended:
                infos[i] = {
                    "terminal_observation": observation[i].copy(), "TimeLimit.truncated": True,
                    "episode": {"r": float(self._return[i]), "l": int(self.batch.elapsed[i]), "t": 0.0},
                }  # fmt: skip
            self._return[ended] = 0.0
            self.batch.start_random(ended, self._rng)
            observation = self.batch.observation()
        return observation, step.reward.astype(np.float32), done, infos

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Restart the random numbers."""
        self._rng = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def close(self) -> None:
        """Nothing to give back."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute once per episode."""
        return [getattr(self, attr_name, None)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Episodes share one batch: there is nothing to set one by one."""
        raise NotImplementedError("the episodes of a twin share one batch; set attributes on it before training")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Episodes share one batch: there is no method of one alone."""
        raise NotImplementedError("the episodes of a twin share one batch and have no methods of their own")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return that no episode is wrapped."""
        return [False] * len(list(self._get_indices(indices)))
