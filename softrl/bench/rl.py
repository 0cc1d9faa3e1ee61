"""bench=rl: environment steps a second of SAC, learning included."""

from dataclasses import dataclass, replace

import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.bench.watch import Timing, Watch
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

        train(first)  # what is compiled or loaded at the first call, which would be taken off the longer training
        short, long = watch.time(lambda: train(first), lambda: train(first + self.steps))
        found = rates(self.steps, short, long)
        return found | {"sac_updates_per_s": found["sac_steps_per_s"] / self.agent.envs * self.agent.gradient_steps}


def rates(steps: int, short: Timing, long: Timing) -> dict[str, float]:
    """Return the rates at which ``steps`` more took from ``short`` to ``long``; the highest only if no repeats overlap.

    Raises
    ------
    ConfigError
        If they took no longer: other work of the machine is all that was timed.
    """
    if long.median <= short.median:
        raise ConfigError(
            f"bench.rl.steps={steps} more took {long.median:.2f} s for {short.median:.2f} s without them; expected longer: "
            "raise it, or stage.repeats"
        )
    spans_s = {
        "sac_steps_per_s": long.median - short.median, "sac_min_steps_per_s": long.maximum - short.minimum,
        "sac_max_steps_per_s": long.minimum - short.maximum,
    }  # fmt: skip
    return {name: steps / span_s for name, span_s in spans_s.items() if span_s > 0.0}
