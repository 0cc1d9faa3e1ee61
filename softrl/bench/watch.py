"""How long things take: several repeats, alternating, and what else the machine was doing."""

import importlib.util
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Timing(NamedTuple):
    """Shortest, median and longest of several repeats, s."""

    minimum: float
    median: float
    maximum: float

    def milliseconds(self, name: str) -> dict[str, float]:
        """Return the metrics ``<name>_ms`` (median), ``<name>_min_ms`` and ``<name>_max_ms``."""
        return {
            f"{name}_ms": 1e3 * self.median, f"{name}_min_ms": 1e3 * self.minimum, f"{name}_max_ms": 1e3 * self.maximum
        }  # fmt: skip

    def rate(self, name: str, count: float = 1.0, unit: str = "per_s") -> dict[str, float]:
        """Return the metrics ``<name>_<unit>`` (median), ``.._min_..`` and ``.._max_..`` of ``count`` things done."""
        return {
            f"{name}_{unit}": count / self.median, f"{name}_min_{unit}": count / self.maximum,
            f"{name}_max_{unit}": count / self.minimum,
        }  # fmt: skip


@dataclass(frozen=True)
class Watch:
    """Times pieces of work.

    Attributes
    ----------
    repeats : of each piece of work
    clock : wall, or cpu, the processor time of this process and its threads, where other work shares the machine
    """

    repeats: int
    clock: str = "wall"

    def now(self) -> float:
        """Return seconds of the clock."""
        return time.process_time() if self.clock == "cpu" else time.perf_counter()

    def time(self, *works: Callable[[], Any], repeats: int | None = None) -> list[Timing]:
        """Return one timing for each of ``works``; they take turns, so that all meet the same load of the machine."""
        taken: list[list[float]] = [[] for _ in works]
        for _ in range(repeats or self.repeats):
            for row, work in zip(taken, works, strict=True):
                began = self.now()
                work()
                row.append(self.now() - began)
        return [timing(row) for row in taken]


def timing(seconds: Sequence[float]) -> Timing:
    """Return shortest, median and longest of ``seconds``."""
    return Timing(float(np.min(seconds)), float(np.median(seconds)), float(np.max(seconds)))


def machine() -> dict[str, Any]:
    """Return what the numbers depend on besides the code: processor, cores, load, threads, versions."""
    packages = ("numpy", "scipy", "numba", "pypardiso", "pybullet", "stable-baselines3", "torch", "scikit-fem")
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load_average": list(os.getloadavg()) if hasattr(os, "getloadavg") else [],
        "threads": os.environ.get("OMP_NUM_THREADS", "as many as cores"),
        "linear_solver": "PARDISO" if importlib.util.find_spec("pypardiso") else "SuperLU",
        "platform": platform.platform(),
        "python": platform.python_version(),
        "versions": {name: version for name in packages if (version := _version(name))},
    }


def load_average() -> float:
    """Return how many processes wanted a core over the last minute; 0 where the system does not tell."""
    return float(os.getloadavg()[0]) if hasattr(os, "getloadavg") else 0.0


def peak_memory_gb() -> float:
    """Return the largest resident memory that this process has had, GB (1e9 bytes)."""
    status = Path("/proc/self/status")
    if status.is_file():  # counts since the program began; what getrusage tells includes the parent's
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return 1024.0 * float(line.split()[1]) / 1e9
    import resource

    unit = 1.0 if platform.system() == "Darwin" else 1024.0
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e9


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.is_file():
        names = [line for line in information.read_text().splitlines() if line.startswith("model name")]
        if names:
            return names[0].partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
