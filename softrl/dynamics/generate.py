"""Millions of samples: random runs in chunks on disk, worked off in parallel, resumed after a kill, read window by window."""

import contextlib
import logging
import os
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from softrl.core.parallel import Parallel
from softrl.core.progress import progress
from softrl.core.resume import Kept
from softrl.dynamics.dataset import Body, Windows, random_loads, rolled
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
ROWS, RATES = "rows.npy", "next_rate.npy"


class StoredWindows(Windows):
    """Windows over two files; what is read stays with the operating system, which may drop it again."""

    def __init__(self, rows: np.ndarray, next_rate: np.ndarray, window: int) -> None:
        self.rows, self.next_rate = torch.from_numpy(rows), torch.from_numpy(next_rate)
        self.window, self.per_run = window, next_rate.shape[1]


@dataclass(frozen=True)
class Recipe:
    """What a chunk of runs is made from.

    Attributes
    ----------
    robot, body : whose motion;  low, high : (n + 3,) Pa and N, range of the loads
    steps, dt_s : of a run;  window : rows of a window, which pad the start
    frame : (n + 3, n + 3) z per y of the reduced model, in whose snapshots |y| <= 1; None where there is none
    """

    robot: Robot
    body: Body
    low: np.ndarray
    high: np.ndarray
    steps: int
    dt_s: float
    window: int
    frame: np.ndarray | None


class Chunk(NamedTuple):
    """Rows (runs, steps + window - 2, features) and rates (runs, steps - 1, 8 + n), float32, and samples in reach."""

    rows: np.ndarray
    next_rate: np.ndarray
    within_reach: int


class Generated(NamedTuple):
    """Windows over all runs; how many of their samples lie within the reach of the snapshots; chunks found made."""

    windows: StoredWindows
    within_reach: int
    resumed: int


def generate_chunks(
    recipe: Recipe, runs: int, runs_per_chunk: int, seed: np.random.SeedSequence, parallel: Parallel, processes: int,
    kept: Kept,
) -> Generated:
    """Return windows over ``runs`` random runs that lie in files under ``kept``.

    Notes
    -----
    A chunk has a seed of its own, so that neither the order of work nor a kill changes it; it counts as made once its
    mark is kept, which is after its rows are on disk. Memory holds a chunk per process, however many runs there are.
    """
    starts = range(0, runs, runs_per_chunk)
    counts = [min(runs_per_chunk, runs - start) for start in starts]
    tasks = [(recipe, *task) for task in zip(counts, seed.spawn(len(counts)), starts, strict=True)]
    _make_files(kept, recipe, runs)
    waiting = [k for k in range(len(tasks)) if f"chunk_{k}" not in kept]
    resumed = len(tasks) - len(waiting)
    if resumed:
        log.info("%d of %d chunks of motion were made by an earlier run and are kept", resumed, len(tasks))
    made = parallel.map(make_chunk, [tasks[k] for k in waiting], processes)
    for number, chunk in progress(made, "chunks of motion", len(waiting)):
        k = waiting[number]
        part = slice(starts[k], starts[k] + counts[k])
        for name, values in ((ROWS, chunk.rows), (RATES, chunk.next_rate)):
            file = np.lib.format.open_memmap(kept.folder / name, mode="r+")  # anew, or all that was written stays mapped
            file[part] = values
            file.flush()
        kept.save(f"chunk_{k}", {"within_reach": np.asarray(chunk.within_reach)})
    within = sum(int(kept.load(f"chunk_{k}")["within_reach"]) for k in range(len(tasks)))
    # copy on write: torch wants memory that it might change
    views = [np.load(kept.folder / name, mmap_mode="c") for name in (ROWS, RATES)]
    return Generated(StoredWindows(*views, recipe.window), within, resumed)


def make_chunk(recipe: Recipe, runs: int, seed: np.random.SeedSequence, first: int = 0) -> Chunk:
    """Return ``runs`` random runs of the recipe's body, of which others come ``first``: what kinds there are goes on."""
    rng = np.random.default_rng(seed)
    load = random_loads(recipe.robot, recipe.low, recipe.high, runs, recipe.steps, recipe.dt_s, rng, first)
    made = rolled(recipe.body, load, recipe.robot.axis, recipe.dt_s)
    windows = Windows(made, recipe.window)
    z = np.concatenate([made.state[..., 8:], made.state[..., :3] - recipe.body.rest_tip], axis=2)
    return Chunk(windows.rows.numpy(), windows.next_rate.numpy(), _within_reach(z[:, 1:], recipe.frame))


def _within_reach(z: np.ndarray, frame: np.ndarray | None) -> int:
    """Return how many of z (..., n + 3) lie where the reduced model has seen snapshots; 0 where that is not known."""
    if frame is None:
        return 0
    y = np.linalg.solve(frame, z.reshape(-1, z.shape[-1]).T)
    return int((np.linalg.norm(y, axis=0) <= 1.0).sum())


def _make_files(kept: Kept, recipe: Recipe, runs: int) -> None:
    """Make the two files at their full size, unless an earlier run left them."""
    n = recipe.robot.chambers
    states, loads = 8 + n, n + 3
    shapes = {
        ROWS: (runs, recipe.steps + recipe.window - 2, 2 * states + loads), RATES: (runs, recipe.steps - 1, states)
    }  # fmt: skip
    kept.use()
    for name, shape in shapes.items():
        if (kept.folder / name).is_file():
            continue
        part = kept.folder / f"{name}.{os.getpid()}.part"
        np.lib.format.open_memmap(part, mode="w+", dtype=np.float32, shape=shape)
        # never over a file that another process has made meanwhile, and may have written to
        with contextlib.suppress(FileExistsError):
            os.link(part, kept.folder / name)
        part.unlink()
