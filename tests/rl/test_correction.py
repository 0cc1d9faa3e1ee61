"""An agent that corrects a clone acts, as one actor, as the two did while it learnt."""

from itertools import pairwise

import numpy as np
import pytest

from softrl.rl.actor import Actor, act_scaled
from softrl.rl.agents.correction import CorrectedVecEnv, corrected
from softrl.rl.batch import Batch
from softrl.rl.vector_env import TwinVecEnv
from softrl.rl.workspace import Workspace
from tests.rl.test_env import task_of

REACH = 0.1


def network(sizes: tuple[int, ...], squash: str, seed: int) -> Actor:
    """Return a random actor."""
    rng, weights = np.random.default_rng(seed), {}
    for i, (size, above) in enumerate(pairwise(sizes)):
        weights[f"weight_{i}"] = (rng.normal(size=(above, size)) / np.sqrt(size)).astype(np.float32)
        weights[f"bias_{i}"] = 0.1 * rng.normal(size=above).astype(np.float32)
    return Actor(weights, "tanh", squash)


@pytest.fixture
def env(space: Workspace) -> TwinVecEnv:
    """Return five episodes on random curves."""
    task = task_of("hybrid", lap_steps=20)
    return TwinVecEnv(Batch(task, space, task.training_goals(2, space, np.random.default_rng(0)), 5), seed=0)


def test_both_are_one_actor(env: TwinVecEnv) -> None:
    size = env.batch.observation_size
    clone, correction = network((size, 8, 6, 3), "clip", 0), network((size, 12, 10, 3), "tanh", 1)
    wrapped, whole = CorrectedVecEnv(env, clone, REACH), corrected(clone, correction, REACH)
    seen = wrapped.reset()
    for _ in range(4):
        wrapped.step_async(act_scaled(correction, seen))
        np.testing.assert_allclose(env._action, act_scaled(whole, seen), atol=2e-4)
        seen = wrapped.step_wait()[0]


def test_no_correction_is_the_clone(env: TwinVecEnv) -> None:
    clone = network((env.batch.observation_size, 8, 6, 3), "clip", 0)
    wrapped = CorrectedVecEnv(env, clone, REACH)
    seen = wrapped.reset()
    wrapped.step_async(np.zeros((5, 3)))
    np.testing.assert_array_equal(env._action, act_scaled(clone, seen))
