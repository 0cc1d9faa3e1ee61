"""Training of f_S: first one step ahead, then over short rollouts, on data plus physics."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from softrl.core.progress import progress
from softrl.core.scaling import Scaler
from softrl.dynamics.checkpoint import NO_CHECKPOINT, Checkpoint, Training, require_finite
from softrl.dynamics.dataset import KINDS, Windows
from softrl.dynamics.physics_residual import PhysicsResidual
from softrl.dynamics.polynomial import LEFT_OUT, MOST_SAMPLES, fit_ridge, left_out
from softrl.dynamics.transformer import ForwardNet, advance

log = logging.getLogger(__name__)
ROLLED, ROLLED_STEPS = 128, 50  # rollouts that choose the ridge of the closed form, and their steps


@dataclass(frozen=True)
class TrainingSettings:
    """How f_S is trained.

    Attributes
    ----------
    batch, learning_rate : of both parts of the training
    onestep_updates, rollout_updates, rollout_steps : one step ahead first; then ``rollout_steps`` from own predictions
    physics_weight : lambda of eq. 10
    seed : of the batches
    """

    batch: int
    onestep_updates: int
    rollout_updates: int
    rollout_steps: int
    learning_rate: float
    physics_weight: float
    seed: int


@dataclass(frozen=True)
class History:
    """Losses by update, dimensionless: 1 is the closed form's prediction one step ahead. ``physics`` is nan without weight."""

    data: np.ndarray
    physics: np.ndarray
    validation_update: np.ndarray
    validation: np.ndarray


def fit_linear(net: ForwardNet, windows: Windows, ridge: float) -> None:
    """Set the scalers of ``net`` and its linear map by least squares; give it training windows only.

    ``ridge`` is relative to the mean square of a scaled feature.
    """
    states = net.states
    scaler = _scaler(windows)
    net.row_mean.copy_(torch.tensor(scaler.mean))
    net.row_spread.copy_(torch.tensor(scaler.spread))
    size = len(net.linear)
    gram, moment = torch.zeros(size, size, dtype=torch.float64), torch.zeros(size, states, dtype=torch.float64)
    for index in torch.arange(len(windows)).split(4096):
        rows, target = windows.take(index)
        x = net.features(net.scaled(rows))[:, -1].double()
        change = (target - net.base(rows)[:, -1]).double()
        gram, moment = gram + x.T @ x, moment + x.T @ change
    net.linear.copy_(torch.linalg.solve(gram + ridge * len(windows) * torch.eye(size, dtype=torch.float64), moment))
    net.closed.zero_()[:size] = net.linear
    _measure_fine(net, windows)


def fit_polynomial(net: ForwardNet, windows: Windows, ridges: Sequence[float], dt_s: float) -> None:
    """Set the polynomial of ``net``, whose linear map is fitted, by least squares on what that leaves.

    Of the ridges the one whose rollouts err least on runs left out; where none is better than the linear map, that stays.
    """
    if not net.polynomial.size:
        return

    def rows_of(index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        rows, target = windows.take(index)
        near = rows[:, -net.linear_rows :]
        return net.closed_features(near, net.scaled(near))[:, -1], target - net.linear_rate(near)[:, -1]

    net.step_s.fill_(dt_s)
    every = torch.arange(0, len(windows), max(len(windows) // MOST_SAMPLES, 1))
    parts = [windows.take(index)[0][:, -net.linear_rows :] for index in every.split(4096)]
    terms = [net.terms(part, net.features(net.scaled(part))) for part in parts]
    net.polynomial.fit_range(*(torch.cat(values)[:, -1] for values in zip(*terms, strict=True)))
    linear = net.closed.clone()

    def drift(coefficients: torch.Tensor) -> float:
        net.closed.copy_(linear + coefficients)
        return _drift(net, windows, dt_s)

    best = fit_ridge(rows_of, windows, ridges, drift)
    net.closed.copy_(linear + best)
    _measure_fine(net, windows)


def _drift(net: ForwardNet, windows: Windows, dt_s: float) -> float:
    """Return the mean square error of tip and volumes, each in its spread, over rollouts of the closed form on runs left out."""
    steps = min(ROLLED_STEPS, windows.per_run // LEFT_OUT)
    starts = torch.arange(0, len(windows), 1)
    starts = starts[left_out(starts, windows) & (starts % windows.per_run <= windows.per_run - steps)]
    index = starts[torch.linspace(0, len(starts) - 1, min(ROLLED, len(starts))).long()]
    rows, load, target = windows.take_segments(index, steps)
    rows, error = rows[:, -net.linear_rows :], torch.zeros_like(target[:, 0])
    total = 0.0
    for k in range(steps):
        rate = net.closed_rate(rows)[:, -1]
        error = error + dt_s * (rate - target[:, k])
        total += float((error / net.row_spread[: net.states])[:, net.own].pow(2).mean()) / steps
        rows = advance(rows, rate, load[:, min(k + 1, steps - 1)], dt_s)
    return total


def _measure_fine(net: ForwardNet, windows: Windows) -> None:
    """Set ``net.fine`` to what the closed form leaves of the rates in training."""
    states = net.states
    square = torch.zeros(states, dtype=torch.float64)
    every = torch.arange(0, len(windows), max(len(windows) // MOST_SAMPLES, 1))
    for index in every.split(4096):
        rows, target = windows.take(index)
        square += (net.closed_rate(rows[:, -net.linear_rows :])[:, -1] - target).double().pow(2).sum(dim=0)
    net.fine.copy_(_shared_by_kind((square / len(every)).sqrt()))


def _scaler(windows: Windows, runs: int = 64) -> Scaler:
    """Return the scaler of all rows, read ``runs`` runs at a time."""
    rows = windows.rows[:, windows.window - 1 :]
    parts = [slice(start, start + runs) for start in range(0, len(rows), runs)]
    count = rows.shape[0] * rows.shape[1]
    mean = sum(rows[part].numpy().astype(float).sum(axis=(0, 1)) for part in parts) / count
    square = sum(((rows[part].numpy() - mean) ** 2).sum(axis=(0, 1)) for part in parts) / count
    spread = np.sqrt(square)
    return Scaler(mean, np.where(spread > 1e-12 * (1.0 + np.abs(mean)), spread, 1.0))


def _shared_by_kind(rms: torch.Tensor) -> torch.Tensor:
    """Return ``rms`` (states,) with at least a tenth of the largest of its kind: a twist of nothing must not count."""
    shared = rms.clone()
    for kind in KINDS:
        shared[kind] = rms[kind].clamp(min=0.1 * float(rms[kind].max()))
    return torch.where(shared > 0.0, shared, 1.0)


def train_forward(
    net: ForwardNet,
    train: Windows,
    validation: Windows,
    physics: PhysicsResidual,
    settings: TrainingSettings,
    checkpoint: Checkpoint = NO_CHECKPOINT,
) -> History:
    """Train ``net`` in place, on from ``checkpoint``, and return how it went.

    Notes
    -----
    Paper eq. 10: loss = data + lambda physics. Both terms are 1 for the closed form's prediction. The second part of
    the updates lets the network read its own predictions for some steps, which keeps rollouts from drifting away.
    """
    generator = torch.Generator().manual_seed(settings.seed)
    optimiser = torch.optim.AdamW(net.parameters(), lr=settings.learning_rate, weight_decay=1e-4)
    updates = settings.onestep_updates + settings.rollout_updates
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.learning_rate, updates + 1, pct_start=0.05)
    losses: dict[str, list[float]] = {"data": [], "physics": [], "validation_update": [], "validation": []}
    training = Training(net, optimiser, schedule, generator, losses)
    checkpoint.restore(training)
    for update in progress(range(training.done, updates), "f_S training"):
        index = torch.randint(len(train), (settings.batch,), generator=generator)
        if update < settings.onestep_updates:
            data, residual = _onestep_loss(net, train, physics, index, settings.physics_weight > 0.0)
        else:
            share = index[: max(settings.batch // settings.rollout_steps, 16)]
            data, residual = _rollout_loss(net, train, physics, share, settings)
        loss = data + settings.physics_weight * residual if settings.physics_weight > 0.0 else data
        require_finite(loss, "f_S", update)
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        losses["data"].append(float(data.detach()))
        losses["physics"].append(float(residual.detach()))
        if update % max(updates // 40, 1) == 0 or update == updates - 1:
            losses["validation_update"].append(update)
            losses["validation"].append(onestep_error(net, validation))
        training.done = update + 1
        checkpoint.keep(training, updates)
    shrink(net, train)
    if losses["validation"][-1] > 1.0:
        log.warning(
            "at the end of its training f_S erred %.3g times as much as its closed form on validation runs, one step ahead, "
            "and was shrunk towards it: lower stage.learning_rate or train on more runs", losses["validation"][-1] ** 0.5
        )  # fmt: skip
    return History(**{name: np.array(values) for name, values in losses.items()})


@torch.no_grad()
def shrink(net: ForwardNet, train: Windows) -> None:
    """Give the network the share, at most all, of its answer that lessens the closed form's errors in training.

    Where the closed form is all but exact, what an optimiser's last steps leave in the network can be larger than what it
    should explain; the share is least squares for each state.
    """
    together, own = torch.zeros(net.states), torch.zeros(net.states)
    for index in torch.arange(0, len(train), max(4 * len(train) // MOST_SAMPLES, 1)).split(2048):
        rows, target = train.take(index)
        closed = net.closed_rate(rows[:, -net.linear_rows :])[:, -1]
        answer = (net.last(rows) - closed) / net.fine
        together += (answer * (target - closed) / net.fine).sum(dim=0)
        own += answer.pow(2).sum(dim=0)
    share = (together / own.clamp(min=1e-30)).clamp(0.0, 1.0)
    net.head.weight.mul_(share[:, None])
    net.head.bias.mul_(share)


def onestep_error(net: ForwardNet, windows: Windows, samples: int = 2000) -> float:
    """Return the mean squared error of the last row's prediction, in units of ``net.fine``, on evenly drawn windows."""
    index = torch.linspace(0, len(windows) - 1, min(samples, len(windows))).long()
    rows, target = windows.take(index)
    with torch.no_grad():
        return float(((net.last(rows) - target) / net.fine).pow(2).mean())


def _onestep_loss(
    net: ForwardNet, train: Windows, physics: PhysicsResidual, index: torch.Tensor, with_physics: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the loss over all rows of the windows, and the physics of the last one."""
    rows, target = train.take(index)
    rate = net(rows)
    # the rate after row k is the rate in row k + 1; the linear map lacks its past in the first rows of a window
    targets = torch.cat([rows[:, 1:, net.states : 2 * net.states], target[:, None]], dim=1)
    data = ((rate - targets) / net.fine)[:, net.linear_rows - 1 :].pow(2).mean()
    residual = physics(rows, rate[:, -1]).pow(2).mean().float() if with_physics else torch.tensor(torch.nan)
    return data, residual


def _rollout_loss(
    net: ForwardNet, train: Windows, physics: PhysicsResidual, index: torch.Tensor, settings: TrainingSettings
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the loss of rates and states over a rollout, and the mean physics along it."""
    steps = settings.rollout_steps
    rows, load, target = train.take_segments(index, steps)
    data, drift = torch.tensor(0.0), torch.zeros(())
    seen, rates = [], []
    for k in range(steps):
        rate = net.last(rows)
        error = (rate - target[:, k]) / net.fine
        drift = drift + error
        # drift is the error of the state in units of fine times dt
        data = data + (error.pow(2).mean() + drift.pow(2).mean() / (k + 1)) / (2 * steps)
        seen.append(rows)
        rates.append(rate)
        if k + 1 < steps:
            rows = advance(rows, rate, load[:, k + 1], physics.dt_s)
    if not settings.physics_weight:
        return data, torch.tensor(torch.nan)
    return data, physics(torch.cat(seen), torch.cat(rates)).pow(2).mean().float()
