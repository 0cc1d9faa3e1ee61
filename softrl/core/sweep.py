"""One parent run over the points of a sweep, closed whatever happens."""

import importlib
import importlib.util
import logging
import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

log = logging.getLogger(__name__)
PARENT_VARIABLE = "SOFTRL_PARENT_RUN"  # read by the points, which may run in processes of their own
_open: list[Any] = []


class Point(NamedTuple):
    """A finished run of a sweep: its flat parameters as written, and its last metrics."""

    params: Mapping[str, str]
    metrics: Mapping[str, float]


def spread_by(points: list[Point], key: str, metric: str) -> dict[str, tuple[float, float]]:
    """Return value of parameter ``key`` -> mean and standard deviation of ``metric`` over the points that have it."""
    values: dict[str, list[float]] = {}
    for point in points:
        if metric in point.metrics:
            values.setdefault(point.params[key], []).append(point.metrics[metric])
    return {value: (float(np.mean(found)), float(np.std(found))) for value, found in values.items()}


class SweepParent(Callback):
    """Opens an MLflow run before a sweep and names it to the points through the environment."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Open the parent run."""
        from softrl.core.store import Location, Store

        store = Store(Location(config.tracking.uri, config.tracking.folder))
        stage = config.hydra.runtime.choices.stage
        overrides = ", ".join(config.hydra.overrides.task)
        run = store.start(f"sweep {stage}", {"stage": f"sweep:{stage}", "overrides": overrides}, parent=None)
        os.environ[PARENT_VARIABLE] = run.id
        _open.append(run)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Close the parent run as finished."""
        close_parents(None)


def close_parents(error: BaseException | None) -> None:
    """Close parent runs that are still open; hydra skips ``on_multirun_end`` after a failure."""
    while _open:
        run = _open.pop()
        points = run.store.points(run.id)
        _conclude(run, points)
        _draw(run, [point for _, point in points])
        run.__exit__(type(error) if error else None, error, None)
    os.environ.pop(PARENT_VARIABLE, None)


def _stage(parent: Any) -> str:
    return str(parent.run.data.tags["softrl.stage"]).removeprefix("sweep:")


def _conclude(parent: Any, points: list[tuple[str, Any]]) -> None:
    """Print the table of the points and keep it; the last one's metrics go on the parent, whose page is empty otherwise."""
    if not points:
        log.info("no point of the sweep finished; parent run %s", parent.id[:8])
        return
    report = importlib.import_module("softrl.report.table")  # above this room, as the rooms of stages are
    rows = [(words, run.info.run_id, run.data.metrics) for words, run in points]
    text = report.sweep_table(_stage(parent), rows)
    log.info("%d points of the sweep finished; parent run %s\n%s", len(points), parent.id[:8], text)
    parent.text("sweep.txt", text)
    for name, value in points[-1][1].data.metrics.items():
        parent.metric(name, value)


def _draw(parent: Any, runs: list[Any]) -> None:
    """Put the figures that the stage's room draws of a sweep on the parent; most rooms draw none."""
    stage = _stage(parent)
    module = f"softrl.{stage}.sweep"
    if importlib.util.find_spec(f"softrl.{stage}") is None or importlib.util.find_spec(module) is None:
        return
    points = [Point(run.data.params, run.data.metrics) for run in runs]
    for name, figure in importlib.import_module(module).draw(points).items():
        parent.figure(name, figure)
