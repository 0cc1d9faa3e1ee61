"""Learned dynamics: random loads through the reduced model -> f_S with a physics loss, and its inverse."""

import logging
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
from softrl.core.errors import ConfigError
from softrl.core.parallel import LOCAL, Parallel
from softrl.core.resume import Kept
from softrl.core.tracking import Tracker
from softrl.dynamics.body import ReducedBody
from softrl.dynamics.checkpoint import NO_CHECKPOINT, Checkpoint
from softrl.dynamics.dataset import Body, Trajectories, Windows, full_order
from softrl.dynamics.evaluate import predictors
from softrl.dynamics.figures import draw_losses
from softrl.dynamics.generate import StoredWindows
from softrl.dynamics.inverse import InverseNet, InverseSettings, inverse_errors, train_inverse
from softrl.dynamics.physics_residual import PhysicsResidual
from softrl.dynamics.report import report_errors, report_samples, residual_shares
from softrl.dynamics.sets import Sets, SetSettings, generate, load_range, stored
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
class Config(SetSettings, TrainingSettings):
    """f_S by a Transformer over a window of states and loads, and its inverse.

    Attributes
    ----------
    SetSettings, TrainingSettings : which runs it is learnt from, and how
    weight : whether the robot's weight acts, as it does in the full model's trajectories; without, f_S is not compared with
        them
    width, heads, layers, feedforward : size of the Transformer
    linear_rows, ridge : rows of its linear part, and their relative ridge (also of the inverse's linear part)
    polynomial_degree, polynomial_ridges : of its closed form in the coordinates, 1 for the linear part alone (of the
        inverse's too), and the ridges from which runs left out choose
    physics_samples : windows that set the residual's scale
    inverse_hidden, inverse_updates, inverse_batch, inverse_learning_rate : the inverse and its training
    cycle_weight : beta of eq. 18
    checkpoint_updates : a training that was killed goes on from its last multiple of this
    gru_update_share : of the updates of f_S, for a recurrent network of equal size beside it; 0 leaves it out
    rollout_s : length of the rollouts that are judged
    """

    weight: bool
    width: int
    heads: int
    layers: int
    feedforward: int
    linear_rows: int
    ridge: float
    polynomial_degree: int
    polynomial_ridges: tuple[float, ...]
    physics_samples: int
    inverse_hidden: int
    inverse_updates: int
    inverse_batch: int
    inverse_learning_rate: float
    cycle_weight: float
    checkpoint_updates: int
    gru_update_share: float
    rollout_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("width", "heads", "layers", "feedforward", "linear_rows", "ridge", "polynomial_degree", "batch",
                     "onestep_updates", "rollout_steps", "learning_rate", "physics_samples", "inverse_hidden",
                     "inverse_updates", "inverse_batch", "inverse_learning_rate", "checkpoint_updates"):  # fmt: skip
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        for name in ("physics_weight", "cycle_weight", "rollout_updates", "gru_update_share"):
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
    low, high = load_range(robot, reduced_model)
    kept, train = Kept("dynamics", _mark(config, robot, reduced_model)), None
    if config.training_runs > config.runs_per_chunk:
        train = stored(config, robot, reduced_model, body, parallel or LOCAL, kept, tracker)
    sets = generate(config, robot, body, low, high, train)
    samples = report_samples(config, snapshots, tracker)
    weights = Kept("dynamics_training", _training_mark(config, kept))
    trainings = {name: Checkpoint(weights, name, config.checkpoint_updates) for name in ("f_S", "gru", "inverse")}
    net, history = learn_forward(config, sets, body, checkpoint=trainings["f_S"])
    others = {"gru": learn_gru(config, sets, body, trainings["gru"])} if config.gru_update_share > 0.0 else {}
    inverse, inverse_losses = learn_inverse(config, net, sets.train, trainings["inverse"])
    tracker.metric("updates_resumed", sum(training.resumed for training in trainings.values()))
    tracker.figure("losses", draw_losses(history, config.onestep_updates, inverse_losses))
    full = full_order(snapshots, gravity, robot.axis, config.dt_s)
    report(config, net, inverse, body, sets, full, tracker, others)
    forward = ForwardDynamics(
        weights_of(net), config.window, config.width, config.heads, config.layers, config.feedforward,
        config.linear_rows, config.dt_s, config.physics_weight, low, high, np.asarray(body.rest_tip), gravity,
        robot.axis, robot.chambers, robot.name, config.polynomial_degree, *samples,
    )  # fmt: skip
    backward = InverseDynamics(
        weights_of(inverse), config.inverse_hidden, config.dt_s, config.cycle_weight, robot.chambers, robot.name,
        config.polynomial_degree,
    )  # fmt: skip
    weights.clear()
    kept.clear()
    return Dynamics(forward, backward)


def _mark(config: Config, robot: Robot, model: ReducedModel) -> str:
    """Return a hash of all that the chunks of motion depend on."""
    arrays = {field.name: getattr(model, field.name) for field in fields(model)}
    settings = {key: value for key, value in asdict(config).items() if key in MOTION_KEYS}
    code = fingerprint.of_code("softrl.dynamics.generate", "softrl.dynamics.body", "softrl.dynamics.sets")
    return fingerprint.of_values([settings, asdict(robot), fingerprint.of_arrays(arrays), code])


def _training_mark(config: Config, motion: Kept) -> str:
    """Return a hash of all that the weights depend on."""
    settings = {key: value for key, value in asdict(config).items() if key not in NO_TRAINING_KEYS}
    return fingerprint.of_values([settings, motion.folder.name, fingerprint.of_code(__name__)])


def _windows(runs: Trajectories | StoredWindows, window: int) -> Windows:
    return runs if isinstance(runs, Windows) else Windows(runs, window)


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
    history = train_forward(net, train, validation, physics, config, checkpoint)
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
    train, windows = _windows(sets.train, config.window), Windows(sets.heldout, config.window)
    physics = PhysicsResidual.fit(body, net, train, config.dt_s, config.physics_samples, config.seed)
    own, least = residual_shares(net, physics, windows)
    tracker.metric("heldout/physics_residual_share", own)
    tracker.metric("heldout/physics_residual_of_motions_share", least)
    known = predictors(net, body, config.dt_s)
    known |= {name: predictors(other, body, config.dt_s)["f_s"] for name, other in others.items()}
    judged = config.dt_s, config.rollout_s, tracker
    report_errors("heldout", known, windows, *judged)
    if sets.outside is not None:
        report_errors("outside", known, Windows(sets.outside, config.window), *judged)
    for name, value in inverse_errors(inverse, net, windows).items():
        tracker.metric(f"heldout/{name}", value)
    if full is None or full.state.shape[1] < config.window + 3:
        log.info(
            "f_S is not compared with the full model: that needs stage.weight=true and its trajectories on stage.dt_s"
        )
        return
    report_errors("full_model", known, Windows(full, config.window, from_rest=False), *judged)
