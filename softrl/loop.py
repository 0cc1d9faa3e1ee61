"""The whole loop, stage after stage, and the table at its end."""

import json
import logging
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from softrl.core.errors import ConfigError
from softrl.core.progress import progress
from softrl.paper import run_paper
from softrl.pipeline import STAGES, Outcome, outputs, run_stage
from softrl.report.table import table

log = logging.getLogger(__name__)
ROOT_KEYS = (
    "robot", "simulator", "task", "agent", "driver", "effect", "tracking", "profile", "stage", "alpha", "lambda", "seed",
    "parallel", "bench", "recordings", "out", "force", "debug", "inputs", "hydra",
)  # fmt: skip
# the plain root keys; the rest are groups, paths, or checked where they are built
ROOT_TYPES: dict[str, tuple[tuple[type, ...], str]] = {
    "seed": ((int,), "whole number from 0 on"),
    "alpha": ((int, float), "share between 0 and 1"),
    "lambda": ((int, float), "number from 0 on"),
    "force": ((bool,), "true or false"),
    "debug": ((bool,), "true or false"),
}


def run_configured(cfg: DictConfig) -> None:
    """Run what the command line asks for: one stage, or all of them in order."""
    chosen: Any = HydraConfig.get()
    folder, stage = Path(chosen.runtime.output_dir), chosen.runtime.choices.stage
    if stage == "paper":
        finished = run_paper(_plain(cfg), list(chosen.overrides.task), folder, _compose)
    elif stage == "all":
        finished = _run_all(list(chosen.overrides.task), folder)
    else:
        finished = [run_stage(stage, _plain(cfg), folder)]
    log.info("%s", table(finished))


def _run_all(overrides: list[str], folder: Path) -> list[Outcome]:
    """Run every stage with the same overrides; an artifact made here is the next stages' input."""
    for word in overrides:
        if word.lstrip("+~").startswith("stage."):
            raise ConfigError(
                f"{word} says nothing about which stage is meant; run that stage alone: stage=<name> {word}"
            )
    shared = [word for word in overrides if not word.startswith("stage=")]
    finished: list[Outcome] = []
    made: dict[str, str] = {}
    for stage in progress(STAGES, "whole loop"):
        outcome = run_stage(stage, _compose([*shared, f"stage={stage}"]), folder / stage, made)
        made |= {name: f"run:{outcome.run_id}" for name in outputs(stage)}
        finished.append(outcome)
    _write_summary(finished, folder)
    return finished


def _compose(overrides: list[str]) -> dict[str, Any]:
    return _plain(hydra.compose("config", overrides))


def _plain(cfg: DictConfig) -> dict[str, Any]:
    container: Any = OmegaConf.to_container(cfg, resolve=True)
    for key in container:
        if key not in ROOT_KEYS:
            raise ConfigError(f"{key}={container[key]} is an unknown key; expected one of {', '.join(ROOT_KEYS)}")
    for key, (kinds, expected) in ROOT_TYPES.items():
        value = container[key]
        if type(value) not in kinds or (type(value) is not bool and value < 0):
            raise ConfigError(f"{key}={value} is no {expected}")
    return {key: value for key, value in container.items() if key != "hydra"}


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
