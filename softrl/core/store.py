"""MLflow as the only hand-over between stages; the one module that imports mlflow."""

import contextlib
import json
import logging
import os
import socket
import sqlite3
import tempfile
import time
from collections.abc import Iterator, Set
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import urlparse
from urllib.request import url2pathname

from filelock import FileLock

from softrl.core.errors import ArtifactError
from softrl.core.fingerprint import of_values

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

from mlflow.entities import Metric, Param, Run
from mlflow.tracking import MlflowClient

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger(__name__)
EXPERIMENT = "softrl"
PARENT = "mlflow.parentRunId"
POINT = "softrl.point."
BATCH = 500
WHOLE_ID = 32  # characters
MOST_RUNS = 10_000  # searched for the beginning of an id
LOCKED_S = 60.0  # waited for other processes that write to the database


@dataclass(frozen=True)
class Location:
    """Where runs are kept: ``uri`` of a server, or none for a database and a folder under ``folder``."""

    uri: str | None
    folder: str


class Store:
    """Runs of stages, found by tags and read in place."""

    def __init__(self, location: Location) -> None:
        folder = Path(location.folder).resolve()
        self._cache = folder / "mlcache"
        if location.uri:
            self.client = MlflowClient(location.uri)
            self.experiment = self._experiment(None)
            return
        folder.mkdir(parents=True, exist_ok=True)
        # several processes that meet a fresh database would all try to migrate it
        with FileLock(folder / "mlflow.db.lock"):
            for name in ("alembic", "mlflow.store.db.utils"):
                logging.getLogger(name).setLevel(logging.WARNING)
            self.client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
            self.experiment = self._experiment(folder)

    def _experiment(self, folder: Path | None) -> str:
        """Return the id of the experiment, whose artifacts lie in ``folder``, or where a server has them."""
        home = None if folder is None else (folder / "mlartifacts").as_uri()
        found = self.client.get_experiment_by_name(EXPERIMENT)
        if found is None:
            return self.client.create_experiment(EXPERIMENT, artifact_location=home)
        if folder is not None and found.artifact_location != home and _is_local(found.artifact_location):
            earlier = _path(found.artifact_location).parent
            log.info("this project was moved: its runs were kept in %s, and are in %s since", earlier, folder)
            _follow(folder, found.experiment_id)
        return found.experiment_id

    def find(self, tags: dict[str, str]) -> Run | None:
        """Return the newest finished run that carries all ``tags``."""
        return next(iter(self.every(tags, 1)), None)

    def every(self, tags: dict[str, str], most: int = MOST_RUNS) -> list[Run]:
        """Return the finished runs that carry all ``tags``, the newest first."""
        condition = " and ".join(f"tags.`softrl.{key}` = '{value}'" for key, value in tags.items())
        return list(
            self.client.search_runs(
                [self.experiment],
                f"attributes.status = 'FINISHED' and {condition}",
                order_by=["attributes.start_time DESC"],
                max_results=most,
            )
        )

    def get(self, run_id: str) -> Run:
        """Return a finished run by its id, or by the beginning of its id that the log shows.

        Raises
        ------
        ArtifactError
            If there is no such run, several begin so, or it did not finish.
        """
        try:
            run = self.client.get_run(self._whole(run_id))
        except ArtifactError:
            raise
        except Exception as error:  # mlflow raises several unrelated classes here
            raise ArtifactError(f"run:{run_id} is not in this tracking store; `make ui` lists the runs") from error
        if run.info.status != "FINISHED":
            raise ArtifactError(f"run:{run_id} is {run.info.status.lower()}, not finished; rerun its stage")
        return run

    def _whole(self, run_id: str) -> str:
        """Return the id that begins with ``run_id``; ``run_id`` itself where none does, or it is whole."""
        if len(run_id) >= WHOLE_ID:
            return run_id
        runs = self.client.search_runs([self.experiment], max_results=MOST_RUNS)
        found = [run.info.run_id for run in runs if run.info.run_id.startswith(run_id)]
        if len(found) > 1:
            raise ArtifactError(f"run:{run_id} is the beginning of {len(found)} runs; give more of the id")
        return found[0] if found else run_id

    def folder(self, run: Run, name: str) -> Path:
        """Return a local folder with the artifact ``name`` of a run; local stores are read in place."""
        if _is_local(run.info.artifact_uri):
            return _path(run.info.artifact_uri) / name
        cached = self._cache / run.info.run_id / name
        if not cached.exists():
            self._download(run.info.run_id, name, cached)
        return cached

    def file(self, run: Run, name: str) -> Path | None:
        """Return a local copy of a run's file ``name``, or None if it has none."""
        return self.folder(run, name) if self.holds(run, {name}) else None

    def holds(self, run: Run, names: Set[str]) -> bool:
        """Return whether a run has the files and folders ``names``."""
        return names <= {file.path for file in self.client.list_artifacts(run.info.run_id)}

    def _download(self, run_id: str, name: str, place: Path) -> None:
        """Download the artifact ``name`` to ``place`` through a sibling, so that what is broken off is never taken for whole."""
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f"{place.name}.", suffix=".part", dir=place.parent) as part:
            whole = Path(self.client.download_artifacts(run_id, name, part))
            try:
                whole.rename(place)
            except OSError:
                if not place.exists():  # else another process was faster
                    raise

    def copy(self, run_id: str, folder: Path) -> list[str]:
        """Copy all files of a run to ``folder``, and return their names there."""
        folder.mkdir(parents=True, exist_ok=True)
        self.client.download_artifacts(run_id, "", str(folder))
        return list(self._names(run_id, None))

    def _names(self, run_id: str, within: str | None) -> Iterator[str]:
        for found in self.client.list_artifacts(run_id, within):
            yield from self._names(run_id, found.path) if found.is_dir else [found.path]

    def add_point(self, parent: str, run_id: str, words: str) -> None:
        """Note at a sweep's parent that ``run_id``, made now or reused, is the point of the overrides ``words``."""
        self.client.set_tag(parent, POINT + of_values(words), f"{run_id} {words}")

    def points(self, parent: str) -> list[tuple[str, Run]]:
        """Return (overrides, run) of a sweep's finished points."""
        tags = self.client.get_run(parent).data.tags
        found = [value.split(" ", 1) for name, value in tags.items() if name.startswith(POINT)]
        return [(words, self.client.get_run(run_id)) for run_id, words in sorted(found, key=lambda point: point[1])]

    def close_abandoned(self) -> int:
        """Mark runs of killed processes on this machine as failed; return how many there were."""
        host = socket.gethostname()
        running = self.client.search_runs(
            [self.experiment], f"attributes.status = 'RUNNING' and tags.`softrl.host` = '{host}'"
        )
        dead = [run for run in running if not _alive(int(run.data.tags["softrl.pid"]))]
        for run in dead:
            self.client.set_terminated(run.info.run_id, "FAILED")
            log.info(
                "run %s of stage %s was killed; it is marked failed",
                run.info.run_id[:8],
                run.data.tags.get("softrl.stage"),
            )
        return len(dead)

    def start(self, name: str, tags: dict[str, str], parent: str | None, folder: Path | None = None) -> "OpenRun":
        """Open a run; its texts are written to ``folder`` too."""
        owner = {"host": socket.gethostname(), "pid": str(os.getpid())}
        all_tags = {f"softrl.{key}": value for key, value in (tags | owner).items()}
        all_tags["mlflow.source.name"] = f"softrl stage={tags['stage']}"
        if parent:
            all_tags[PARENT] = parent
        run = self.client.create_run(self.experiment, run_name=name, tags=all_tags)
        return OpenRun(self, run, folder)


class OpenRun:
    """One run while its stage works: a ``Tracker`` that is finished, or marked failed, exactly once."""

    def __init__(self, store: Store, run: Run, folder: Path | None = None) -> None:
        self.store, self.run, self.folder = store, run, folder
        self.id: str = run.info.run_id
        self.metrics: dict[str, float] = {}
        self._buffer: list[Metric] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._flush()
        if kind is None:
            self.store.client.set_terminated(self.id, "FINISHED")
            return
        self.store.client.set_tag(self.id, "softrl.error", f"{kind.__name__}: {error}"[:400])
        self.store.client.set_terminated(self.id, "KILLED" if kind is KeyboardInterrupt else "FAILED")

    def metric(self, name: str, value: float, step: int | None = None) -> None:
        """Record a number, sent in batches."""
        self.metrics[name] = float(value)
        self._buffer.append(Metric(name, float(value), int(time.time() * 1000), step or 0))
        if len(self._buffer) >= BATCH:
            self._flush()

    def figure(self, name: str, figure: "Figure") -> None:
        """Record a figure as PNG."""
        self.store.client.log_figure(self.id, figure, f"figures/{name}.png")
        figure.clear()

    def text(self, name: str, content: str) -> None:
        """Record a text file."""
        if self.folder:
            write_text(self.folder / name, content)
        self.store.client.log_text(self.id, content, name)

    def params(self, values: dict[str, Any]) -> None:
        """Record flat parameters, and all of them as ``config.json``."""
        flat = [Param(key, str(value)[:500]) for key, value in values.items()]
        for start in range(0, len(flat), 100):
            self.store.client.log_batch(self.id, params=flat[start : start + 100])
        self.text("config.json", json.dumps(values, indent=1, default=str))

    def link(self, inputs: dict[str, str]) -> None:
        """Show on the run's page where its figures are and which runs its inputs came from."""
        page = f"#/experiments/{self.store.experiment}/runs"
        lines = [f"- {name}: [{run_id}]({page}/{run_id})" for name, run_id in inputs.items()]
        figures = f"[Figures, reports and artifacts]({page}/{self.id}/artifacts)"
        note = "\n".join([figures, "", *(["Inputs", "", *lines] if lines else [])])
        self.store.client.set_tag(self.id, "mlflow.note.content", note)

    def artifact(self, name: str, artifact: Any) -> None:
        """Store an artifact under ``name``; it appears whole or not at all."""
        with tempfile.TemporaryDirectory(prefix="softrl-") as scratch:
            artifact.save(Path(scratch) / name)
            self.store.client.log_artifacts(self.id, str(Path(scratch) / name), name)

    def _flush(self) -> None:
        if self._buffer:
            self.store.client.log_batch(self.id, metrics=self._buffer)
            self._buffer = []


def write_text(path: Path, content: str) -> None:
    """Write a file through a temporary sibling, so that no half of it is ever seen."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    part.write_text(content)
    part.rename(path)


def _is_local(uri: str) -> bool:
    return uri.startswith(("file:", "/"))


def _path(uri: str) -> Path:
    return Path(url2pathname(urlparse(uri).path))


def _follow(folder: Path, experiment: str) -> None:
    """Tell the database that its project was moved to ``folder``: it holds whole paths, of the experiment and of each run.

    MLflow has no call for that. Runs whose files are not here, and those that still run, stay where they are.
    """
    home = folder / "mlartifacts"
    with contextlib.closing(sqlite3.connect(folder / "mlflow.db", timeout=LOCKED_S)) as opened, opened as database:
        ended = database.execute("SELECT run_uuid FROM runs WHERE experiment_id = ? AND status != 'RUNNING'", (int(experiment),))
        here = [run_id for (run_id,) in ended.fetchall() if (home / run_id).is_dir()]
        places = [(f"{home.as_uri()}/{run_id}/artifacts", run_id) for run_id in here]
        database.executemany("UPDATE runs SET artifact_uri = ? WHERE run_uuid = ?", places)
        database.execute(
            "UPDATE experiments SET artifact_location = ? WHERE experiment_id = ?", (home.as_uri(), int(experiment))
        )


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
