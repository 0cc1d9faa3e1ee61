"""bench=rl: environment steps a second of SAC, learning included."""

from dataclasses import dataclass, replace

import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.bench.watch import Watch
from softrl.core.errors import ConfigError
from softrl.core.tracking import Tracker
from softrl.rl.agents.agent import Practice
from softrl.rl.agents.sac import Sac
from softrl.rl.batch import Batch
from softrl.rl.tasks.task import Task
from softrl.rl.vector_env import TwinVecEnv
from softrl.rl.workspace import Workspace

CURVES = 16


@dataclass(frozen=True)
class RlBench:
    """SAC as conf/agent/sac.yaml configures it, on the twin.

    Attributes
    ----------
    steps : of the environments in a timed run, after those that only fill the buffer
    """

    surrogate: Surrogate
    task: Task
    agent: Sac
    steps: int

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ConfigError(f"bench.rl.steps={self.steps} must be at least 1")

    def measure(self, watch: Watch, seed: int, tracker: Tracker) -> dict[str, float]:
        """Return the metrics: the difference of a longer and a shorter training, so that setting up does not count."""
        space = Workspace(self.surrogate)
        goals = self.task.training_goals(CURVES, space, np.random.default_rng(seed))
        practice = Practice(lambda size, start: TwinVecEnv(Batch(self.task, space, goals, size), start), lambda actor: 0.0)
        first = self.agent.learning_starts + self.agent.envs

        def train(steps: int) -> None:
            replace(self.agent, steps=steps, judge_every=10 * (first + self.steps)).train(practice, seed)

        short, long = watch.time(lambda: train(first), lambda: train(first + self.steps))
        rate = self.steps / max(long.median - short.median, 1e-9)
        updates = rate / self.agent.envs * self.agent.gradient_steps
        return {
            "sac_steps_per_s": rate,
            "sac_min_steps_per_s": self.steps / max(long.maximum - short.minimum, 1e-9),
            "sac_max_steps_per_s": self.steps / max(long.minimum - short.maximum, 1e-9),
            "sac_updates_per_s": updates,
        }
