"""What a bench measured, and on which machine."""

from dataclasses import dataclass
from typing import Any, ClassVar

from softrl.artifacts.artifact import Artifact


@dataclass(frozen=True)
class Benchmark(Artifact):
    """Numbers of one bench run.

    Attributes
    ----------
    benches : which benches ran
    machine : processor, cores, threads, load average, versions
    metrics : name -> value; units in the names
    robot_name : the robot
    """

    stage: ClassVar[str] = "bench"

    benches: list[str]
    machine: dict[str, Any]
    metrics: dict[str, Any]
    robot_name: str

    def document(self) -> dict[str, Any]:
        """Return the numbers for readers outside."""
        return {"robot": self.robot_name, "benches": self.benches, "machine": self.machine, "metrics": self.metrics}
