"""`stage=paper`: the stages behind the paper's tables for several seeds, and their rows as ``paper.json``."""

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softrl.core.config import build
from softrl.core.errors import ConfigError, SoftrlError
from softrl.core.progress import progress
from softrl.core.store import write_text
from softrl.pipeline import Outcome, outputs, run_stage
from softrl.report.paper import collect, table_of

log = logging.getLogger(__name__)
BODY = ("mesh", "fem", "pod")
Compose = Callable[[list[str]], dict[str, Any]]


@dataclass(frozen=True)
class Config:
    """Which runs stand behind the tables.

    Attributes
    ----------
    seeds : of everything that is learned or recorded;  body_seed : of mesh, fem and pod
    tasks : of stage rl;  rollouts : whether policies are rolled out on the driver
    benches : of stage bench, run once
    keep : file that the rows are copied to, or null
    """

    seeds: tuple[int, ...]
    body_seed: int
    tasks: tuple[str, ...]
    rollouts: bool
    benches: tuple[str, ...]
    keep: str | None

    def __post_init__(self) -> None:
        if not self.seeds or len(set(self.seeds)) != len(self.seeds):
            raise ConfigError(f"stage.seeds={list(self.seeds)}; expected one or more, all different")


class Runs:
    """Runs stages and keeps what they measured, and why one failed."""

    def __init__(self, shared: list[str], folder: Path, compose: Compose) -> None:
        self._shared, self._folder, self._compose = shared, folder, compose
        self.finished: list[Outcome] = []
        self.results: dict[str, list[dict[str, float]]] = {}
        self.why_not: dict[str, str] = {}
        self.commands: dict[str, str] = {}

    def go(self, stage: str, seed: int, made: dict[str, str], *words: str, name: str = "") -> bool:
        """Run ``stage`` and add its artifacts to ``made``; return whether it finished."""
        name = name or stage
        overrides = [*self._shared, *words, f"seed={seed}"]
        self.commands[name] = " ".join(["python -m softrl", f"stage={stage}", *self._shared, *words])
        try:
            config = self._compose([*overrides, f"stage={stage}"])
            outcome = run_stage(stage, config, self._folder / f"{name.replace(':', '_')}_{seed}", made)
        except SoftrlError as error:
            log.warning("%s with seed %d failed: %s", name, seed, error)
            self.why_not[name] = f"seed {seed}: {error}"
            return False
        made |= {kind: f"run:{outcome.run_id}" for kind in outputs(stage)}
        self.results.setdefault(name, []).append(outcome.metrics)
        self.finished.append(outcome)
        return True


def run_paper(cfg: Mapping[str, Any], words: list[str], folder: Path, compose: Compose) -> list[Outcome]:
    """Return the runs behind the tables after writing ``paper.json`` and ``paper.md`` to ``folder``."""
    config = build(cfg["stage"], Config, "stage")
    shared = [w for w in words if not w.lstrip("+~").startswith(("stage=", "stage.", "seed=", "task="))]
    runs, body = Runs(shared, folder, compose), dict[str, str]()
    for stage in BODY:
        given = [cfg["inputs"].get(name, "latest") for name in outputs(stage)]
        if all(source != "latest" for source in given):
            log.info("%s: inputs name its artifacts; not run", stage)
        elif not runs.go(stage, config.body_seed, body):
            break
    for seed in progress(config.seeds, "seeds"):
        _one_seed(runs, config, seed, dict(body))
        _write(runs, cfg, config, folder)  # what is there is there, should the next seed be stopped
    return runs.finished


def _one_seed(runs: Runs, config: Config, seed: int, made: dict[str, str]) -> None:
    """Run everything that is learned or recorded with ``seed``; what stands on a failed run is left out."""
    calibrated = runs.go("calibration", seed, made)
    runs.go("dynamics", seed, made)
    if not runs.go("surrogate", seed, made):
        return
    for task in config.tasks:
        own = dict(made)
        learned = runs.go("rl", seed, own, f"task={task}", name=f"rl:{task}")
        if learned and task == "track":
            made |= own
    if "policy" not in made or not calibrated:
        return
    if config.rollouts:
        runs.go("sim2real", seed, made, "task=track")
    if config.benches and seed == config.seeds[0]:
        runs.go("bench", seed, made, f"bench=[{','.join(config.benches)}]")


def _write(runs: Runs, cfg: Mapping[str, Any], config: Config, folder: Path) -> None:
    rows = collect(runs.results, runs.why_not, runs.commands, cfg["profile"]["name"])
    text = json.dumps(rows, indent=1)
    write_text(folder / "paper.json", text)
    write_text(folder / "paper.md", table_of(rows))
    if config.keep:
        write_text(Path(config.keep), text)
    missing = sum(row["ours_mean"] is None for row in rows)
    log.info("paper: %d of %d rows measured, %s", len(rows) - missing, len(rows), folder / "paper.md")
