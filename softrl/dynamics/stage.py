"""Learned dynamics: random loads through the reduced model -> f_S with a physics loss, and its inverse."""

import logging
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import torch

from softrl.artifacts.dynamics import ForwardDynamics, InverseDynamics
from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core import fingerprint
from softrl.core.errors import ConfigError, SolverError
from softrl.core.parallel import LOCAL, Parallel
from softrl.core.resume import Kept
from softrl.core.tracking import Tracker
from softrl.dynamics.body import ReducedBody
from softrl.dynamics.checkpoint import NO_CHECKPOINT, Checkpoint
from softrl.dynamics.dataset import Body, Trajectories, Windows, full_order, random_loads, rolled
from softrl.dynamics.evaluate import Predictor, onestep_errors, predictors, rollout, rollout_errors
from softrl.dynamics.figures import draw_losses, draw_rollout, table
from softrl.dynamics.generate import Recipe, StoredWindows, generate_chunks
from softrl.dynamics.inverse import InverseNet, InverseSettings, inverse_errors, train_inverse
from softrl.dynamics.physics_residual import PhysicsResidual
from softrl.dynamics.training import History, TrainingSettings, fit_linear, fit_polynomial, train_forward
from softrl.dynamics.transformer import ForwardNet, GruNet, weights_of
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)


# settings that change neither motion nor weights
NO_TRAINING_KEYS = ("processes", "checkpoint_updates", "heldout_runs", "rollout_s", "outside_runs", "outside_load_factor",
                    "outside_speed_factor")  # fmt: skip
# settings that the motion depends on
MOTION_KEYS = ("training_runs", "runs_per_chunk", "run_s", "dt_s", "weight", "window", "seed")


@dataclass(frozen=True)
class Config:
    """f_S by a Transformer over a window of states and loads, and its inverse.

    Attributes
    ----------
    training_runs, validation_runs, heldout_runs, run_s, dt_s : random runs of the reduced model
    runs_per_chunk : more training runs than this are kept in chunks on disk and read window by window
    processes : that make chunks
    weight : whether the robot's weight acts, as it does in the full model's trajectories; without, f_S is not compared with
        them
    window : rows that the Transformer sees;  width, heads, layers, feedforward : its size
    linear_rows, ridge : rows of its linear part, and their relative ridge (also of the inverse's linear part)
    polynomial_degree, polynomial_ridges : of its closed form in the coordinates, 1 for the linear part alone (of the
        inverse's too), and the ridges from which runs left out choose
    batch, onestep_updates, rollout_updates, rollout_steps, learning_rate : training; the second part predicts
        ``rollout_steps`` from its own predictions
    physics_weight : lambda of eq. 10;  physics_samples : windows that set the residual's scale
    inverse_hidden, inverse_updates, inverse_batch, inverse_learning_rate : the inverse and its training
    cycle_weight : beta of eq. 18
    checkpoint_updates : a training that was killed goes on from its last multiple of this
    gru_update_share : of the updates of f_S, for a recurrent network of equal size beside it; 0 leaves it out
    rollout_s : length of the rollouts that are judged
    outside_runs : a further test set from outside of what was trained on; 0 leaves it out
    outside_load_factor, outside_speed_factor : its loads span the training's range by this factor, and change this
        much faster, the slew limit included
    """

    training_runs: int
    validation_runs: int
    heldout_runs: int
    runs_per_chunk: int
    processes: int
    run_s: float
    dt_s: float
    weight: bool
    window: int
    width: int
    heads: int
    layers: int
    feedforward: int
    linear_rows: int
    ridge: float
    polynomial_degree: int
    polynomial_ridges: tuple[float, ...]
    batch: int
    onestep_updates: int
    rollout_updates: int
    rollout_steps: int
    learning_rate: float
    physics_weight: float
    physics_samples: int
    inverse_hidden: int
    inverse_updates: int
    inverse_batch: int
    inverse_learning_rate: float
    cycle_weight: float
    checkpoint_updates: int
    gru_update_share: float
    rollout_s: float
    outside_runs: int
    outside_load_factor: float
    outside_speed_factor: float
    seed: int

    def __post_init__(self) -> None:
        positive = ("training_runs", "validation_runs", "heldout_runs", "runs_per_chunk", "processes",
                    "run_s", "dt_s", "heads", "layers", "feedforward", "linear_rows", "ridge", "polynomial_degree",
                    "onestep_updates", "rollout_steps", "learning_rate",
                    "physics_samples", "inverse_hidden", "inverse_updates", "inverse_learning_rate", "checkpoint_updates",
                    "outside_load_factor", "outside_speed_factor")  # fmt: skip
        for name in positive:
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        for name in ("physics_weight", "cycle_weight", "rollout_updates", "gru_update_share", "outside_runs"):
            if getattr(self, name) < 0:
                key = "lambda" if name == "physics_weight" else f"stage.{name}"
                raise ConfigError(f"{key}={getattr(self, name):g} must not be negative")
        if not self.polynomial_ridges or min(self.polynomial_ridges) <= 0.0:
            raise ConfigError(f"stage.polynomial_ridges={list(self.polynomial_ridges)}; expected one or more, all positive")
        if self.width % self.heads:
            raise ConfigError(f"stage.width={self.width} is no multiple of stage.heads={self.heads}")
        if self.window < self.linear_rows:
            raise ConfigError(f"stage.window={self.window} is below stage.linear_rows={self.linear_rows}")
        if self.window < 2:
            raise ConfigError(f"stage.window={self.window}; expected 2 or more, the inverse reads two rows")
        longest = max(self.rollout_s, self.dt_s * (self.rollout_steps + self.window))
        if self.run_s < longest + self.dt_s:
            raise ConfigError(
                f"stage.run_s={self.run_s:g} is too short; rollouts and windows need {longest:g} s and a step"
            )


class Dynamics(NamedTuple):
    """f_S and its inverse."""

    forward: ForwardDynamics
    inverse: InverseDynamics


class Sets(NamedTuple):
    """Runs of the reduced model, split whole."""

    train: Trajectories | StoredWindows
    validation: Trajectories
    heldout: Trajectories
    outside: Trajectories | None = None


def run(
    config: Config,
    robot: Robot,
    reduced_model: ReducedModel,
    snapshots: Snapshots,
    parallel: Parallel | None = None,
    *,
    tracker: Tracker,
) -> Dynamics:
    """Return f_S and its inverse; errors on held-out runs and on the full model's are logged beside baselines."""
    torch.set_num_threads(1)
    gravity = np.array(robot.gravity_m_s2) * config.weight
    body = ReducedBody(reduced_model, gravity)
    low, high = _load_range(robot, reduced_model)
    kept = Kept("dynamics", _mark(config, robot, reduced_model))
    sets = generate(config, robot, body, low, high)
    if config.training_runs > config.runs_per_chunk:
        sets = sets._replace(train=_many(config, robot, reduced_model, body, parallel or LOCAL, kept, tracker))
    report_data(config, sets, snapshots, tracker)
    weights = Kept("dynamics_training", _training_mark(config, kept))
    trainings = {name: Checkpoint(weights, name, config.checkpoint_updates) for name in ("f_S", "gru", "inverse")}
    net, history = learn_forward(config, sets, body, checkpoint=trainings["f_S"])
    others = {"gru": learn_gru(config, sets, body, trainings["gru"])} if config.gru_update_share > 0.0 else {}
    inverse, inverse_losses = learn_inverse(config, net, sets.train, trainings["inverse"])
    tracker.metric("updates_resumed", sum(training.resumed for training in trainings.values()))
    tracker.figure("losses", draw_losses(history, inverse_losses))
    full = full_order(snapshots, gravity, robot.axis, config.dt_s)
    report(config, net, inverse, body, sets, full, tracker, others)
    forward = ForwardDynamics(
        weights_of(net), config.window, config.width, config.heads, config.layers, config.feedforward,
        config.linear_rows, config.dt_s, config.physics_weight, low, high, np.asarray(body.rest_tip), gravity,
        robot.axis, robot.chambers, robot.name, config.polynomial_degree,
    )  # fmt: skip
    backward = InverseDynamics(
        weights_of(inverse), config.inverse_hidden, config.dt_s, config.cycle_weight, robot.chambers, robot.name,
        config.polynomial_degree,
    )  # fmt: skip
    weights.clear()
    kept.clear()
    return Dynamics(forward, backward)


def _load_range(robot: Robot, model: ReducedModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the loads (n + 3,) that both the robot is made for and the reduced model has seen."""
    n = robot.chambers
    force = robot.tip_force_max_n / 3**0.5  # a corner of the cube of forces then has the robot's largest force
    low = np.concatenate([np.full(n, robot.pressure_min_pa), np.full(3, -force)])
    high = np.concatenate([np.full(n, robot.pressure_max_pa), np.full(3, force)])
    return np.maximum(low, model.load_low), np.minimum(high, model.load_high)


def _mark(config: Config, robot: Robot, model: ReducedModel) -> str:
    """Return a hash of all that the chunks of motion depend on."""
    arrays = {field.name: getattr(model, field.name) for field in fields(model)}
    settings = {key: value for key, value in asdict(config).items() if key in MOTION_KEYS}
    code = fingerprint.of_code("softrl.dynamics.generate", "softrl.dynamics.body")
    return fingerprint.of_values([settings, asdict(robot), fingerprint.of_arrays(arrays), code])


def _training_mark(config: Config, motion: Kept) -> str:
    """Return a hash of all that the weights depend on."""
    settings = {key: value for key, value in asdict(config).items() if key not in NO_TRAINING_KEYS}
    code = fingerprint.of_code("softrl.dynamics.training", "softrl.dynamics.inverse")
    return fingerprint.of_values([settings, motion.folder.name, code])


def _many(
    config: Config, robot: Robot, model: ReducedModel, body: Body, parallel: Parallel, kept: Kept, tracker: Tracker
) -> StoredWindows:
    """Return windows over training runs that are too many for the memory."""
    steps = round(config.run_s / config.dt_s) + 1
    known = model.frame.shape == (robot.chambers + 3, robot.chambers + 3)
    frame = model.frame if known else None
    recipe = Recipe(robot, body, *_load_range(robot, model), steps, config.dt_s, config.window, frame)
    seed, began = np.random.SeedSequence(config.seed).spawn(3)[0], time.monotonic()
    made = generate_chunks(recipe, config.training_runs, config.runs_per_chunk, seed, parallel, config.processes, kept)
    samples = len(made.windows)
    log.info("%d samples of motion in %.0f s", samples, time.monotonic() - began)
    tracker.metric("chunks_resumed", made.resumed)
    if known:
        tracker.metric("samples_within_reach_pct", 100.0 * made.within_reach / samples)
    return made.windows


def report_data(config: Config, sets: Sets, snapshots: Snapshots, tracker: Tracker) -> None:
    """Log how many samples there are, and the share that the full model made: all of them test, none of them train."""
    steps = round(config.run_s / config.dt_s)
    reduced = steps * (config.training_runs + config.validation_runs + config.heldout_runs)
    full = snapshots.trajectory_load.shape[0] * snapshots.trajectory_load.shape[1]
    tracker.metric("training_samples", steps * config.training_runs)
    tracker.metric("reduced_model_samples", reduced)
    tracker.metric("full_order_samples", full)
    tracker.metric("full_order_share_pct", 100.0 * full / (full + reduced))


def _windows(runs: Trajectories | StoredWindows, window: int) -> Windows:
    return runs if isinstance(runs, Windows) else Windows(runs, window)


def generate(config: Config, robot: Robot, body: Body, low: np.ndarray, high: np.ndarray) -> Sets:
    """Return random runs of ``body``, split whole into training, validation and held-out runs.

    More training runs than a chunk holds are left out here but for the first chunk.
    """
    counts = (min(config.training_runs, config.runs_per_chunk), config.validation_runs, config.heldout_runs)
    steps = round(config.run_s / config.dt_s) + 1
    seeds = np.random.SeedSequence(config.seed).spawn(3)
    sets = []
    for count, seed in zip(counts, seeds, strict=True):
        load = random_loads(robot, low, high, count, steps, config.dt_s, np.random.default_rng(seed))
        sets.append(rolled(body, load, robot.axis, config.dt_s))
    return Sets(*sets, outside=_outside(config, robot, body, low, high) if config.outside_runs else None)


def _outside(config: Config, robot: Robot, body: Body, low: np.ndarray, high: np.ndarray) -> Trajectories | None:
    """Return runs of loads that are larger and change faster than any in training, or None where the body gives up."""
    rng = np.random.default_rng(np.random.SeedSequence(config.seed).spawn(4)[3])
    factor, speed = config.outside_load_factor, config.outside_speed_factor
    steps = round(config.run_s / config.dt_s) + 1
    # a longer step makes the same programs pass in fewer of them
    load = random_loads(
        robot, factor * low, factor * high, config.outside_runs, steps, speed * config.dt_s, rng
    )  # fmt: skip
    try:
        return rolled(body, load, robot.axis, config.dt_s)
    except SolverError as error:
        log.warning("no errors outside of the training's range: %s; lower stage.outside_load_factor", error)
        return None


def learn_gru(config: Config, sets: Sets, body: Body, checkpoint: Checkpoint = NO_CHECKPOINT) -> ForwardNet:
    """Return the recurrent baseline, trained on data alone by a share of the updates of f_S."""
    share = config.gru_update_share
    own = replace(
        config, physics_weight=0.0, onestep_updates=max(1, round(share * config.onestep_updates)),
        rollout_updates=round(share * config.rollout_updates),
    )  # fmt: skip
    return learn_forward(own, sets, body, GruNet, checkpoint)[0]


def learn_forward(
    config: Config,
    sets: Sets,
    body: Body,
    kind: type[ForwardNet] = ForwardNet,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> tuple[ForwardNet, History]:
    """Return the trained network and how its training went."""
    train, validation = _windows(sets.train, config.window), Windows(sets.validation, config.window)
    states, loads = sets.validation.state.shape[2], sets.validation.load.shape[2]
    torch.manual_seed(config.seed)
    net = kind(
        states, loads, config.window, config.width, config.heads, config.layers, config.feedforward, config.linear_rows,
        config.polynomial_degree,
    )  # fmt: skip
    fit_linear(net, train, config.ridge)
    fit_polynomial(net, train, config.polynomial_ridges, config.dt_s)
    physics = PhysicsResidual.fit(body, net, train, config.dt_s, config.physics_samples, config.seed)
    settings = TrainingSettings(
        config.batch, config.onestep_updates, config.rollout_updates, config.rollout_steps, config.learning_rate,
        config.physics_weight, config.seed,
    )  # fmt: skip
    history = train_forward(net, train, validation, physics, settings, checkpoint)
    return net.eval(), history


def learn_inverse(
    config: Config, net: ForwardNet, runs: Trajectories | StoredWindows, checkpoint: Checkpoint = NO_CHECKPOINT
) -> tuple[InverseNet, np.ndarray]:
    """Return the trained inverse and its losses (updates, 2)."""
    settings = InverseSettings(
        config.inverse_hidden, config.inverse_updates, config.inverse_batch, config.inverse_learning_rate,
        config.cycle_weight, config.ridge, config.polynomial_ridges, config.polynomial_degree, config.dt_s, config.seed,
    )  # fmt: skip
    return train_inverse(net, _windows(runs, config.window), settings, checkpoint)


def report(
    config: Config,
    net: ForwardNet,
    inverse: InverseNet,
    body: Body,
    sets: Sets,
    full: Trajectories | None,
    tracker: Tracker,
    others: Mapping[str, ForwardNet] = MappingProxyType({}),
) -> None:
    """Log errors, baselines, table and figures on held-out runs and, where there are any, the full model's runs.

    ``others`` are further networks to compare with, by name.
    """
    windows = Windows(sets.heldout, config.window)
    tracker.metric(
        "heldout/physics_residual_share",
        _residual_share(config, net, body, _windows(sets.train, config.window), windows),
    )
    known = predictors(net, body, config.dt_s)
    known |= {name: predictors(other, body, config.dt_s)["f_s"] for name, other in others.items()}
    _report_set("heldout", known, windows, config, tracker)
    if sets.outside is not None:
        _report_set("outside", known, Windows(sets.outside, config.window), config, tracker)
    for name, value in inverse_errors(inverse, net, windows).items():
        tracker.metric(f"heldout/{name}", value)
    if full is None or full.state.shape[1] < config.window + 3:
        log.info(
            "f_S is not compared with the full model: that needs stage.weight=false and its trajectories on stage.dt_s"
        )
        return
    _report_set("full_model", known, Windows(full, config.window, from_rest=False), config, tracker)


def _residual_share(config: Config, net: ForwardNet, body: Body, train: Windows, heldout: Windows) -> float:
    """Return the rms physics residual of f_S on held-out windows; 1 is that of the linear prediction there."""
    physics = PhysicsResidual.fit(body, net, train, config.dt_s, config.physics_samples, config.seed)
    rows, _ = heldout.take(torch.arange(len(heldout)))
    with torch.no_grad():
        linear = net.linear_rate(rows[:, -net.linear_rows :])[:, -1]
        own, plain = (physics(rows[:, -1], rate).pow(2).mean(dim=0) for rate in (net.last(rows), linear))
    return float((own / plain.clamp(min=1e-30)).mean().sqrt())


def _report_set(split: str, known: dict[str, Predictor], windows: Windows, config: Config, tracker: Tracker) -> None:
    steps = min(round(config.rollout_s / config.dt_s), windows.per_run)
    errors = {
        name: onestep_errors(predict, windows, config.dt_s) | rollout_errors(predict, windows, steps, config.dt_s)
        for name, predict in known.items()
    }
    for name, values in errors.items():
        for key, value in values.items():
            # the reduced model made these runs and predicts no rotation: what it would score there says nothing
            if name != "rom" or (split == "full_model" and "orientation" not in key):
                tracker.metric(f"{split}/{key}" if name == "f_s" else f"{split}/{name}_{key}", value)
    tracker.text(f"errors_{split}.md", table(errors))
    first = torch.tensor([0])
    paths = {name: rollout(known[name], windows, first, windows.per_run, config.dt_s) for name in ("f_s", "arx")}
    time = config.dt_s * np.arange(1, windows.per_run + 1)
    states = {name: path[0][0] for name, path in paths.items()}
    tracker.figure(
        f"rollout_{split}", draw_rollout(time, states, paths["f_s"][1][0], f"whole run, {split.replace('_', ' ')}")
    )
