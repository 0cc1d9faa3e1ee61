"""Work shared out among processes, and how much there was: steps of bodies, by whichever process."""

from collections.abc import Callable, Sequence
from typing import Any

import joblib

from softrl.core.progress import quiet

VALVE_STEP = 0.125  # of a lumped body's step: the time that one of a valve takes
steps = 0


def note(count: int) -> None:
    """Count more steps."""
    global steps
    steps += count


def parallel(task: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int) -> list[Any]:
    """Return ``task(*job)`` of every job, in order, in ``workers`` processes."""
    if workers == 1 or len(jobs) < 2:
        return [task(*job) for job in jobs]
    pool = joblib.Parallel(n_jobs=workers, inner_max_num_threads=1)
    made = list(pool(joblib.delayed(_quietly)(task, job) for job in jobs))
    note(sum(count for _, count in made))
    return [found for found, _ in made]


def _quietly(task: Callable[..., Any], job: tuple[Any, ...]) -> tuple[Any, int]:
    """Return ``task(*job)`` and the steps that it took, in a process of its own.

    That has no log: its warnings would go to the terminal as they are.
    """
    before = steps
    with quiet():
        return task(*job), steps - before
