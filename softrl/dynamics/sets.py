"""Random runs of the reduced model: what is learnt from, what chooses, and what judges."""

import logging
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.core.errors import ConfigError, SolverError
from softrl.core.parallel import Parallel
from softrl.core.resume import Kept
from softrl.core.tracking import Tracker
from softrl.dynamics.dataset import Body, Trajectories, random_loads, rolled
from softrl.dynamics.generate import Recipe, StoredWindows, generate_chunks
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SetSettings:
    """Which random runs of the reduced model are made.

    Attributes
    ----------
    training_runs, validation_runs, heldout_runs, run_s, dt_s : how many, how long, in which steps
    runs_per_chunk : more training runs than this are kept in chunks on disk and read window by window
    processes : that make chunks
    window : rows that the Transformer sees
    outside_runs : a further test set from outside of what was trained on; 0 leaves it out
    outside_load_factor, outside_speed_factor : its loads span the training's range by this factor, and change this
        much faster, the slew limit included
    seed : of the loads
    """

    training_runs: int
    validation_runs: int
    heldout_runs: int
    runs_per_chunk: int
    processes: int
    run_s: float
    dt_s: float
    window: int
    outside_runs: int
    outside_load_factor: float
    outside_speed_factor: float
    seed: int

    def __post_init__(self) -> None:
        for name in ("training_runs", "validation_runs", "heldout_runs", "runs_per_chunk", "processes", "run_s", "dt_s",
                     "outside_load_factor", "outside_speed_factor"):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        if self.outside_runs < 0:
            raise ConfigError(f"stage.outside_runs={self.outside_runs:g} must not be negative")

    @property
    def rows(self) -> int:
        """States of a run, the first one included."""
        return round(self.run_s / self.dt_s) + 1


class Sets(NamedTuple):
    """Runs of the reduced model, split whole."""

    train: Trajectories | StoredWindows
    validation: Trajectories
    heldout: Trajectories
    outside: Trajectories | None = None


def load_range(robot: Robot, model: ReducedModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the loads (n + 3,) that both the robot is made for and the reduced model has seen."""
    n = robot.chambers
    force = robot.tip_force_max_n / 3**0.5  # a corner of the cube of forces then has the robot's largest force
    low = np.concatenate([np.full(n, robot.pressure_min_pa), np.full(3, -force)])
    high = np.concatenate([np.full(n, robot.pressure_max_pa), np.full(3, force)])
    return np.maximum(low, model.load_low), np.minimum(high, model.load_high)


def generate(
    settings: SetSettings, robot: Robot, body: Body, low: np.ndarray, high: np.ndarray, train: StoredWindows | None = None
) -> Sets:
    """Return random runs of ``body``, split whole into training, validation and held-out runs.

    ``train`` are training runs that are made already, as by ``stored``.
    """
    seeds = _seeds(settings)

    def made(count: int, seed: np.random.SeedSequence) -> Trajectories:
        load = random_loads(robot, low, high, count, settings.rows, settings.dt_s, np.random.default_rng(seed))
        return rolled(body, load, robot.axis, settings.dt_s)

    return Sets(
        made(settings.training_runs, seeds[0]) if train is None else train,
        made(settings.validation_runs, seeds[1]),
        made(settings.heldout_runs, seeds[2]),
        _outside(settings, robot, body, low, high, seeds[3]) if settings.outside_runs else None,
    )


def stored(
    settings: SetSettings, robot: Robot, model: ReducedModel, body: Body, parallel: Parallel, kept: Kept, tracker: Tracker
) -> StoredWindows:
    """Return windows over training runs that are too many for the memory."""
    known = model.frame.shape == (robot.chambers + 3, robot.chambers + 3)
    frame = model.frame if known else None
    recipe = Recipe(robot, body, *load_range(robot, model), settings.rows, settings.dt_s, settings.window, frame)
    counts, began = (settings.training_runs, settings.runs_per_chunk), time.monotonic()
    made = generate_chunks(recipe, *counts, _seeds(settings)[0], parallel, settings.processes, kept)
    samples = len(made.windows)
    log.info("%d samples of motion in %.0f s", samples, time.monotonic() - began)
    tracker.metric("chunks_resumed", made.resumed)
    if known:
        tracker.metric("samples_within_reach_pct", 100.0 * made.within_reach / samples)
    return made.windows


def _seeds(settings: SetSettings) -> list[np.random.SeedSequence]:
    """Return the seeds of the training, validation, held-out and outside runs."""
    return np.random.SeedSequence(settings.seed).spawn(4)


def _outside(
    settings: SetSettings, robot: Robot, body: Body, low: np.ndarray, high: np.ndarray, seed: np.random.SeedSequence
) -> Trajectories | None:
    """Return runs of loads that are larger and change faster than any in training, or None where the body gives up."""
    factor, speed = settings.outside_load_factor, settings.outside_speed_factor
    # a longer step makes the same programs pass in fewer of them
    load = random_loads(
        robot, factor * low, factor * high, settings.outside_runs, settings.rows, speed * settings.dt_s,
        np.random.default_rng(seed),
    )  # fmt: skip
    try:
        return rolled(body, load, robot.axis, settings.dt_s)
    except SolverError as error:
        log.warning("no errors outside of the training's range: %s; lower stage.outside_load_factor", error)
        return None
