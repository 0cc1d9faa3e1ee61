"""Independent tasks on the cores of one machine or on a cluster: the same call, the same results."""

import importlib
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from joblib import Parallel as JoblibParallel
from joblib import delayed, parallel_config

from softrl.core.errors import ConfigError

log = logging.getLogger(__name__)
BACKENDS = ("loky", "dask")
CONNECT_S = 10


@dataclass(frozen=True)
class Parallel:
    """Where tasks are worked off. No result depends on it.

    Attributes
    ----------
    backend : loky, processes of this machine, or dask, the workers of a running Dask cluster
    processes : of loky; None for as many as the caller asks for
    address : of the Dask scheduler, ``tcp://host:port``
    """

    backend: str
    processes: int | None
    address: str | None

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise ConfigError(f"parallel.backend={self.backend} is unknown; expected {' or '.join(BACKENDS)}")
        if self.processes is not None and self.processes < 1:
            raise ConfigError(f"parallel.processes={self.processes} must be at least 1, or null")
        if (self.address is None) != (self.backend == "loky"):
            raise ConfigError(
                f"parallel.backend={self.backend} with parallel.address={self.address}: dask needs the address of its "
                "scheduler (parallel=dask parallel.address=tcp://host:port), loky takes none"
            )

    def map(
        self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], processes: int = 1
    ) -> Iterator[tuple[int, Any]]:
        """Yield (number of the task, ``function(*task)``) in the order in which tasks finish.

        Parameters
        ----------
        function : importable by name, as its arguments' classes are; the workers of a cluster need softrl installed
        processes : of loky where the configuration names none

        Notes
        -----
        A task runs with one thread, so that processes do not fight for cores and sums keep their order. A cluster works
        off again what a dying worker held; a dying process of this machine ends the map with an error.
        """
        if not tasks:
            return
        with ExitStack() as stack:
            stack.enter_context(self._backend(stack))
            count = self.processes or processes if self.backend == "loky" else -1
            # one task a batch: what is finished is handed over at once, and may be kept
            pool = JoblibParallel(n_jobs=count, batch_size=1, return_as="generator_unordered")
            yield from pool(delayed(_numbered)(number, function, task) for number, task in enumerate(tasks))

    def _backend(self, stack: ExitStack) -> AbstractContextManager[Any]:
        if self.backend == "loky":
            return parallel_config(backend="loky", inner_max_num_threads=1)
        stack.enter_context(_client(str(self.address)))
        return parallel_config(backend="dask", wait_for_workers_timeout=CONNECT_S)


LOCAL = Parallel("loky", None, None)


def seeds(seed: int, count: int) -> list[np.random.SeedSequence]:
    """Return ``count`` independent seeds, one a task: the draws do not depend on who works off which task."""
    return np.random.SeedSequence(seed).spawn(count)


def _numbered(number: int, function: Callable[..., Any], task: tuple[Any, ...]) -> tuple[int, Any]:
    return number, function(*task)


def _client(address: str) -> AbstractContextManager[Any]:
    """Return the open client of a Dask cluster."""
    try:
        distributed: Any = importlib.import_module("distributed")
    except ModuleNotFoundError as missing:
        raise ConfigError("parallel=dask needs Dask; install it with pip install 'softrl[cluster]'") from missing
    try:
        client: Any = distributed.Client(address, timeout=CONNECT_S, set_as_default=True)
    except (OSError, ValueError) as failure:
        raise ConfigError(
            f"parallel.address={address} answers nothing within {CONNECT_S} s ({failure}); start a scheduler "
            "(dask scheduler) and workers (dask worker tcp://host:port --nthreads 1), or check the address"
        ) from failure
    log.info("Dask cluster at %s with %d workers", address, len(client.scheduler_info()["workers"]))
    return client
