"""The stages in order, and how one is run: inputs found, objects built, outputs stored."""

import functools
import importlib
import json
import logging
import os
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from softrl.artifacts.artifact import Artifact
from softrl.assembly import Assembly, output_kinds
from softrl.core import config as configuration
from softrl.core import fingerprint
from softrl.core.errors import ConfigError
from softrl.core.store import Location, OpenRun, Store, write_text
from softrl.core.sweep import PARENT_VARIABLE

log = logging.getLogger(__name__)

# the loop, in order; the word is the room's folder, the value of `stage`, and the tag in MLflow
STAGES = ("mesh", "fem", "pod", "calibration", "dynamics", "surrogate", "rl", "sim2real", "diagnosis")
# stages beside the loop
EXTRA = ("simulate", "bench", "excite", "proof")
TIMED = "bench"
RESULT = "result.json"
COPIED = "copied"  # in the result of a folder out=..: the files that were copied there


@dataclass(frozen=True)
class Outcome:
    """What a stage left: where, and the numbers."""

    stage: str
    run_id: str
    reused: bool
    seconds: float
    metrics: dict[str, float]
    folder: Path


def run_stage(stage: str, cfg: Mapping[str, Any], folder: Path, made: Mapping[str, str] | None = None) -> Outcome:
    """Run one stage with the resolved configuration ``cfg``, or reuse a finished run that did the same.

    Alone, a stage at a real robot and a bench are always run.

    Parameters
    ----------
    folder : where ``result.json`` goes
    made : artifact name -> run id, outputs of earlier stages of the same invocation; they take the place of ``latest``
    """
    task = _prepare(stage, cfg, made)
    store, assembly = task.store, task.assembly
    if made is None:
        assembly.warn_of_unused(stage)
    if task.before is not None:
        run_id = task.before.info.run_id
        log.info("%s: run %s did the same already and is reused (force=true runs it again)", stage, run_id[:8])
        if made is None and PARENT_VARIABLE not in os.environ:  # else nobody goes on with the latest
            _warn_of_newer(stage, assembly, task.before)
        if assembly.at_device:
            log.warning("%s: the robot is not moved, run %s is of before; this stage alone would move it", stage, run_id[:8])
        if task.write_out is not None:
            task.write_out(*_loaded(store, task.before, stage))
        _copy(store, run_id, task.out)
        return _reused(store, stage, task.before, folder)
    log.info("%s: started", stage)
    start = time.monotonic()
    tags = _tags(stage, task.mark, assembly)
    name = ", ".join([f"{stage} {tags.get('task', '')}".rstrip(), tags["profile"], f"seed {tags['seed']}"])
    with store.start(name, tags, os.environ.get(PARENT_VARIABLE), folder) as run:
        run.params(_flat(cfg))
        run.link(assembly.inputs)
        try:
            output = task.run(task.config, **task.arguments, tracker=run)
        except BaseException as error:
            _write_result(run, stage, "failed", start, assembly.inputs, [], error=str(error))
            raise
        artifacts = {type(artifact).key(): artifact for artifact in _parts(output)}
        for name, artifact in artifacts.items():
            run.artifact(name, artifact)
            _write_document(run, stage, artifact)
        result = _write_result(run, stage, "finished", start, assembly.inputs, list(artifacts))
    log.info("%s: finished in %.1f s, run %s", stage, result["seconds"], run.id[:8])
    if task.write_out is not None:
        task.write_out(*_parts(output))
    _copy(store, run.id, task.out)
    return Outcome(stage, run.id, False, result["seconds"], run.metrics, folder)


def finished_before(stage: str, cfg: Mapping[str, Any], made: Mapping[str, str]) -> str | None:
    """Return the id of the run that ``run_stage`` would reuse, or None."""
    before = _prepare(stage, cfg, made).before
    return None if before is None else str(before.info.run_id)


def outputs(stage: str) -> list[str]:
    """Return the names of the artifacts that a stage makes."""
    return [kind.key() for kind in _kinds(stage)]


def _kinds(stage: str) -> list[type[Artifact]]:
    return output_kinds(importlib.import_module(f"softrl.{stage}.stage").run)


def _loaded(store: Store, run: Any, stage: str) -> list[Artifact]:
    """Return the artifacts that a finished run made."""
    return [kind.load(store.folder(run, kind.key())) for kind in _kinds(stage)]


def _warn_of_newer(stage: str, assembly: Assembly, before: Any) -> None:
    """Tell that other stages take a newer run than the one that was reused, and how to choose it."""
    latest = {kind.key(): assembly.latest(kind) for kind in _kinds(stage)} if stage in STAGES else {}
    newer = {name: run for name, run in latest.items() if run is not None and run.info.start_time > before.info.start_time}
    if newer:
        chosen = " ".join(f"inputs.{name}=run:{before.info.run_id[:8]}" for name in newer)
        log.warning("%s: run %s is newer, and what other stages take; give them %s for the reused one", stage,
                    next(iter(newer.values())).info.run_id[:8], chosen)  # fmt: skip


class _Prepared(NamedTuple):
    """All that a stage needs, and the finished run that did the same."""

    store: Store
    assembly: Assembly
    run: Callable[..., Any]
    config: Any
    arguments: dict[str, Any]
    mark: str
    before: Any
    out: Path | None
    write_out: Callable[..., None] | None


def _prepare(stage: str, cfg: Mapping[str, Any], made: Mapping[str, str] | None) -> _Prepared:
    if stage not in STAGES + EXTRA:
        raise ConfigError(f"stage={stage} is unknown; expected all, {', '.join(STAGES + EXTRA)}")
    store = Store(Location(cfg["tracking"]["uri"], cfg["tracking"]["folder"]))
    store.close_abandoned()
    module = importlib.import_module(f"softrl.{stage}.stage")
    assembly = Assembly(store, cfg, dict(made or {}))
    config = configuration.build(cfg["stage"], module.Config, "stage")
    if made is None:  # of several stages each takes what it can
        assembly.refuse_unused_effects(stage, module.run)
    writes_itself = hasattr(module, "write_out")  # a dataset, and nothing else
    out = None if writes_itself or not cfg["out"] else _own_folder(cfg["out"])
    write_out = functools.partial(module.write_out, config, assembly.robot) if writes_itself else None
    if writes_itself and config.out is not None:
        module.require_own(Path(config.out).expanduser())  # found out before the work
    arguments = assembly.arguments(module.run)
    mark = _fingerprint(stage, assembly)
    # what a robot or this machine does is in no fingerprint; of several stages those that are finished are gone on from
    again = cfg["force"] or (made is None and (assembly.at_device or stage == TIMED))
    before = None if again else _whole(store, store.find({"stage": stage, "fingerprint": mark}), stage)
    return _Prepared(store, assembly, module.run, config, arguments, mark, before, out, write_out)


def _whole(store: Store, run: Any, stage: str) -> Any:
    """Return a finished ``run`` with all that it left, else None: its files may have been removed since."""
    if run is None or store.holds(run, {RESULT, *outputs(stage)}):
        return run
    log.warning("%s: run %s did the same already, but its files are gone; it is run again", stage, run.info.run_id[:8])
    return None


def _own_folder(out: str) -> Path:
    """Return the folder ``out``, which must be new or hold what a stage copied there."""
    folder = Path(out).expanduser()
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir()) and not (folder / RESULT).is_file()):
        raise ConfigError(f"out={out} holds something else than a stage's results; choose another folder")
    return folder


def _copy(store: Store, run_id: str, folder: Path | None) -> None:
    """Copy all that a run left to the user's folder, in place of what was copied there before."""
    if folder is None:
        return
    _remove_copied(folder)
    names = store.copy(run_id, folder)
    result = json.loads((folder / RESULT).read_text())
    write_text(folder / RESULT, json.dumps(result | {COPIED: names}, indent=1))
    log.info("copied artifacts, figures and reports to %s", folder)


def _remove_copied(folder: Path) -> None:
    """Remove the files that an earlier run left in ``folder``, and subfolders that are empty then; other files stay."""
    try:
        earlier = json.loads((folder / RESULT).read_text())[COPIED]
    except (FileNotFoundError, ValueError, TypeError, KeyError):  # a new folder, or a result that was not copied
        return
    ours = [folder / name for name in earlier if (folder / name).resolve().is_relative_to(folder.resolve())]
    for file in ours:
        file.unlink(missing_ok=True)
    for parent in sorted({parent for file in ours for parent in file.parents}, reverse=True):
        if folder in parent.parents and parent.is_dir() and not any(parent.iterdir()):
            parent.rmdir()


def _fingerprint(stage: str, assembly: Assembly) -> str:
    """Return the hash of all that can change a stage's result: configuration, inputs, code, files."""
    code, files = fingerprint.of_code(*assembly.modules), fingerprint.of_named_files(assembly.used)
    return fingerprint.of_values(
        [stage, assembly.used, assembly.inputs, code, files, _assets_mark(assembly.robot.name)]
    )


def _tags(stage: str, mark: str, assembly: Assembly) -> dict[str, str]:
    return {
        "stage": stage,
        "fingerprint": mark,
        "robot": assembly.robot_mark,
        "robot_name": assembly.robot.name,
        "profile": assembly.cfg["profile"]["name"],
        "git": _git_revision(),
        "inputs": json.dumps(assembly.inputs),
        "seed": str(assembly.cfg["seed"]),
        "artifacts": " ".join(outputs(stage)),
    } | assembly.own_tags()


def _parts(output: Any) -> list[Artifact]:
    return [output] if isinstance(output, Artifact) else list(output)


def _reused(store: Store, stage: str, run: Any, folder: Path) -> Outcome:
    result = json.loads(store.folder(run, RESULT).read_text())
    places = {name: str(store.folder(run, name)) for name in result["artifacts"]}  # the project may have been moved since
    write_text(folder / RESULT, json.dumps(result | {"artifacts": places, "reused": True}, indent=1))
    for name in (f"{stage}.json", "report.html"):
        if (document := store.file(run, name)) is not None:
            write_text(folder / name, document.read_text())
    return Outcome(stage, run.info.run_id, True, result["seconds"], result["metrics"], folder)


def _write_result(
    run: OpenRun,
    stage: str,
    status: str,
    start: float,
    inputs: Mapping[str, str],
    names: list[str],
    error: str | None = None,
) -> dict[str, Any]:
    result = {
        "stage": stage,
        "run_id": run.id,
        "status": status,
        "seconds": round(time.monotonic() - start, 3),
        "inputs": dict(inputs),
        "metrics": run.metrics,
        "artifacts": {name: str(run.store.folder(run.run, name)) for name in names},
    }
    text = json.dumps(result | ({"error": error} if error else {}), indent=1)
    run.text(RESULT, text)
    return result


def _write_document(run: OpenRun, stage: str, artifact: Artifact) -> None:
    """Write ``<stage>.json`` for an artifact that has a form for readers outside (``document()``)."""
    if hasattr(artifact, "document"):
        text = json.dumps(artifact.document(), indent=1)
        run.text(f"{stage}.json", text)


def _flat(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in node.items():
        if isinstance(value, Mapping) and value:
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _assets_mark(robot: str) -> str:
    """Return a hash of what is shipped for a robot: sample meshes, curves."""
    folders = [root / "assets" / robot for root in (Path(__file__).parent, Path(__file__).parents[1])]
    return "".join(fingerprint.of_folder(folder) for folder in folders if folder.is_dir())


def _git_revision() -> str:
    """Return the revision of the sources; installed elsewhere than in a checkout, or without git, they have none."""
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return "unknown"
    try:
        done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return "unknown"
    return done.stdout.strip() or "unknown"
