"""The benches of what is learned run, and report what the paper's rows and README take from them."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.bench.policy import PolicyBench
from softrl.bench.rl import RlBench, rates
from softrl.bench.stage import Bench, Config, run
from softrl.bench.surrogate import SurrogateBench
from softrl.bench.watch import Timing, Watch
from softrl.core.config import build_target
from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from softrl.robots.robot import Robot
from softrl.surrogate.simulator import SurrogateSimulator

CONF = Path(__file__).parents[2] / "conf"


def test_a_rate_that_was_not_seen_is_not_told() -> None:
    short, long = Timing(1.0, 2.0, 4.0), Timing(3.0, 6.0, 7.0)
    assert rates(100, short, long) == pytest.approx({"sac_steps_per_s": 25.0, "sac_min_steps_per_s": 100.0 / 6.0})
    assert rates(100, short, Timing(5.0, 6.0, 7.0))["sac_max_steps_per_s"] == pytest.approx(100.0)
    with pytest.raises(ConfigError, match=r"bench.rl.steps=100 more took 2.00 s for 2.00 s without them"):
        rates(100, short, short)


def test_what_is_loaded_at_the_first_call_is_not_taken_off_the_longer_training(monkeypatch: pytest.MonkeyPatch) -> None:
    """A training that takes a second for 100 steps, and ten more the first time: 100 steps a second, not a complaint."""
    clock = [0.0]

    @dataclass(frozen=True)
    class Agent:
        steps: int = 0
        judge_every: int = 0
        learning_starts: int = 90
        envs: int = 10
        gradient_steps: int = 1

        def train(self, practice: object, seed: int) -> None:
            clock[0] += 0.01 * self.steps + (0.0 if clock[0] else 10.0)

    class Clock(Watch):
        def now(self) -> float:
            return clock[0]

    monkeypatch.setattr("softrl.bench.rl.Workspace", lambda surrogate: None)
    task = SimpleNamespace(training_goals=lambda *_: None)
    bench = RlBench(None, task, Agent(), 200)  # type: ignore[arg-type]
    assert bench.measure(Clock(1), 0, NullTracker())["sac_steps_per_s"] == pytest.approx(100.0)


@pytest.mark.slow
def test_what_is_quoted_of_them_is_reported(
    tripod: Robot, surrogate: Surrogate, policy: Policy, calibration: Calibration
) -> None:
    task = build_target(yaml.safe_load((CONF / "task/track.yaml").read_text()) | {"alpha": 0.5}, "task")
    small = {"hidden": 16, "envs": 8, "learning_starts": 100, "gradient_steps": 1}
    agent = build_target(yaml.safe_load((CONF / "agent/sac.yaml").read_text()) | small, "agent")
    benches: dict[str, Bench] = {
        "policy": PolicyBench(policy, surrogate, calibration, 20),
        "surrogate": SurrogateBench(SurrogateSimulator(tripod, surrogate, 1.0, 24.0, 1.0), task, 20, 10, 20, 8, 80),
        "rl": RlBench(surrogate, task, agent, 200),
    }
    made = run(Config(1, "cpu", 0), tripod, benches, tracker=NullTracker())
    promised = {"policy_hz", "policy_latency_p99_ms", "pybullet_control_steps_per_s", "twin_env_steps_per_s", "sac_steps_per_s"}
    assert promised <= set(made.metrics) and all(np.isfinite(made.metrics[name]) for name in made.metrics)
    assert all(made.metrics[name] > 0.0 for name in promised)
