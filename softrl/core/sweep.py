"""One parent run over the points of a sweep, closed whatever happens."""

import logging
import os
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

log = logging.getLogger(__name__)
PARENT_VARIABLE = "SOFTRL_PARENT_RUN"  # read by the points, which may run in processes of their own
_open: list[Any] = []


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
        _copy_best_child(run)
        run.__exit__(type(error) if error else None, error, None)
    os.environ.pop(PARENT_VARIABLE, None)


def _copy_best_child(parent: Any) -> None:
    """Put the last finished child's metrics on the parent: its page is empty otherwise."""
    children = parent.store.children(parent.id)
    log.info("sweep of %d points; parent run %s", len(children), parent.id)
    if children:
        for name, value in children[0].data.metrics.items():
            parent.metric(name, value)
