"""The whole loop, stage after stage, and the table at its end."""

import json
import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from softrl.artifacts.makers import check_inputs
from softrl.aside import Aside
from softrl.core.errors import ConfigError, SolverError
from softrl.core.progress import progress
from softrl.core.store import Location, Store
from softrl.core.sweep import PARENT_VARIABLE
from softrl.core.threads import cores
from softrl.paper import run_paper
from softrl.pipeline import STAGES, Outcome, finished_before, outputs, run_stage
from softrl.report.table import table

log = logging.getLogger(__name__)
ROOT_KEYS = (
    "robot", "simulator", "task", "agent", "driver", "effect", "tracking", "profile", "stage", "alpha", "lambda", "seed",
    "parallel", "bench", "recordings", "out", "force", "debug", "inputs", "hydra",
)  # fmt: skip
TAKEN_BY_NONE = "dynamics"  # the stage of the loop whose artifacts no other takes: it runs beside them
# the plain root keys: types, smallest and largest value, and both in words; groups are checked where they are built
LARGEST_SEED = 2**32 - 1  # that every library takes
ROOT_RANGES: dict[str, tuple[tuple[type, ...], float, float, str]] = {
    "seed": ((int,), 0, LARGEST_SEED, f"a whole number from 0 to {LARGEST_SEED}"),
    "alpha": ((int, float), 0.0, 1.0, "a share between 0 and 1"),
    "lambda": ((int, float), 0.0, sys.float_info.max, "a number from 0 on"),
    "force": ((bool,), False, True, "true or false"),
    "debug": ((bool,), False, True, "true or false"),
}


def run_configured(cfg: DictConfig) -> None:
    """Run what the command line asks for: one stage, or all of them in order."""
    chosen: Any = HydraConfig.get()
    folder, stage = Path(chosen.runtime.output_dir), chosen.runtime.choices.stage
    if stage == "paper":
        finished = run_paper(_plain(cfg), list(chosen.overrides.task), folder, _compose)
        if not finished:
            raise SolverError(f"none of the runs behind the paper's tables finished; {folder / 'paper.md'} says why")
    elif stage == "all":
        finished = _run_all(list(chosen.overrides.task), folder)
    else:
        finished = [run_stage(stage, _plain(cfg), folder)]
    if parent := os.environ.get(PARENT_VARIABLE):  # the sweep ends in one table of all its points
        location = Location(cfg.tracking.uri, cfg.tracking.folder)
        Store(location).add_point(parent, finished[-1].run_id, " ".join(chosen.overrides.task))
    else:
        # of the paper's runs many are of one stage: their rows say of which task, and with what spread over seeds
        log.info("%s", "\n" + (folder / "paper.md").read_text() if stage == "paper" else table(finished))


def _run_all(overrides: list[str], folder: Path) -> list[Outcome]:
    """Run every stage with the same overrides; an artifact made here is the next stages' input."""
    for word in overrides:
        if word.lstrip("+~").startswith("stage."):
            raise ConfigError(
                f"{word} says nothing about which stage is meant; run that stage alone: stage=<name> {word}"
            )
    shared = [word for word in overrides if not word.startswith("stage=")]
    found: dict[str, Outcome] = {}
    made: dict[str, str] = {}
    aside: Aside | None = None
    try:
        for stage in progress(STAGES, "whole loop"):
            config = _compose([*shared, f"stage={stage}"])
            config["out"] = config["out"] and f"{config['out']}/{stage}"
            if stage == TAKEN_BY_NONE and cores() > 1 and not finished_before(stage, config, made):
                aside = Aside(stage, config, folder / stage, made)
                continue
            found[stage] = run_stage(stage, config, folder / stage, made)
            made |= {name: f"run:{found[stage].run_id}" for name in outputs(stage)}
            if aside:
                aside.check()
        if aside:
            found[TAKEN_BY_NONE] = aside.outcome()
    finally:
        if aside:
            aside.stop()
    finished = [found[stage] for stage in STAGES]
    _write_summary(finished, folder)
    return finished


def _compose(overrides: list[str]) -> dict[str, Any]:
    return _plain(hydra.compose("config", overrides))


def _plain(cfg: DictConfig) -> dict[str, Any]:
    container: Any = OmegaConf.to_container(cfg, resolve=True)
    for key in container:
        if key not in ROOT_KEYS:
            raise ConfigError(f"{key}={container[key]} is an unknown key; expected one of {', '.join(ROOT_KEYS)}")
    for key in ROOT_RANGES:
        _require(key, container[key], key)
    for path, value in _seeds(container["stage"], "stage"):
        _require("seed", value, path)
    for key in ("recordings", "out"):
        if container[key] is not None and not isinstance(container[key], str):
            raise ConfigError(f"{key}={container[key]} is refused; expected a folder, such as {key}=./{container[key]}")
    check_inputs(container["inputs"])
    return _apart({key: value for key, value in container.items() if key != "hydra"})


def _require(key: str, value: Any, path: str) -> None:
    kinds, low, high, expected = ROOT_RANGES[key]
    if type(value) not in kinds or not low <= value <= high:
        raise ConfigError(f"{path}={value} is refused; expected {expected}")


def _seeds(node: dict[str, Any], path: str) -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of each seed in a stage's configuration: most are the root's, but may be set apart."""
    for key, value in node.items():
        if key == "seed":
            yield f"{path}.{key}", value
        elif isinstance(value, dict):
            yield from _seeds(value, f"{path}.{key}")


def _apart(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration with a folder ``out`` of its own for each point of a sweep: their results would be mixed."""
    chosen: Any = HydraConfig.get().job if HydraConfig.initialized() else {}
    point = chosen.get("num")  # as in the name of the point's output folder
    for node in (config, config["stage"]):
        if point is not None and node.get("out"):
            node["out"] = f"{node['out']}/{point}"
    return config


def _write_summary(finished: list[Outcome], folder: Path) -> None:
    summary = {
        "stage": "all",
        "run_id": finished[-1].run_id,
        "status": "finished",
        "seconds": round(sum(outcome.seconds for outcome in finished), 3),
        "inputs": {outcome.stage: outcome.run_id for outcome in finished},
        "metrics": {f"{o.stage}/{name}": value for o in finished for name, value in o.metrics.items()},
        "artifacts": {outcome.stage: str(outcome.folder) for outcome in finished},
    }
    (folder / "result.json").write_text(json.dumps(summary, indent=1))
