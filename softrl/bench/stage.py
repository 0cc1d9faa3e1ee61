"""bench: speed and accuracy, measured on this machine beside a baseline in the same run."""

import json
import logging
from dataclasses import dataclass
from typing import Protocol

from softrl.artifacts.benchmark import Benchmark
from softrl.bench.watch import Watch, load_average, machine
from softrl.core.errors import ConfigError
from softrl.core.tracking import Tracker
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)


class Bench(Protocol):
    """One bench; it takes its artifacts and simulators as it is built."""

    def measure(self, watch: Watch, seed: int, tracker: Tracker) -> dict[str, float]:
        """Return metrics by name, units in the names."""
        ...


@dataclass(frozen=True)
class Config:
    """How everything is timed.

    Attributes
    ----------
    repeats : of each timing; its median, shortest and longest are reported
    clock : wall, or cpu where other work shares the machine
    """

    repeats: int
    clock: str
    seed: int

    def __post_init__(self) -> None:
        if self.repeats < 1:
            raise ConfigError(f"stage.repeats={self.repeats} must be at least 1")
        if self.clock not in ("wall", "cpu"):
            raise ConfigError(f"stage.clock={self.clock} is unknown; expected wall or cpu")


def run(config: Config, robot: Robot, bench: dict[str, Bench], *, tracker: Tracker) -> Benchmark:
    """Return what the chosen benches measured; two of them may not use one name for two things."""
    metrics: dict[str, float] = {"load_average_before": load_average()}
    for name, chosen in bench.items():
        log.info("bench %s", name)
        found = chosen.measure(Watch(config.repeats, config.clock), config.seed, tracker)
        assert not set(found) & set(metrics), set(found) & set(metrics)
        metrics |= found
    metrics["cpu_clock"] = float(config.clock == "cpu")
    metrics["load_average_after"] = load_average()
    for name, value in metrics.items():
        tracker.metric(name, value)
    tracker.text("machine.json", json.dumps(machine(), indent=1))
    return Benchmark(list(bench), machine(), metrics, robot.name)
