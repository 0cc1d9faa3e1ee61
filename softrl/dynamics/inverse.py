"""f_S^dagger: the pressures that make the wanted next rate, trained with the cycle through f_S."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from softrl.artifacts.dynamics import InverseDynamics
from softrl.core.progress import progress
from softrl.dynamics.checkpoint import NO_CHECKPOINT, Checkpoint, Training, require_finite
from softrl.dynamics.dataset import Windows
from softrl.dynamics.transformer import ForwardNet


class InverseNet(nn.Module):
    """Pressures (B, n) Pa from state, rate, tip force and wanted next rate: a linear map plus two tanh layers.

    Attributes
    ----------
    row_mean, row_spread, change : scalers of a row, and of the change of a rate over one step
    linear : (features + 1, n) Pa by scaled features, fixed by least squares before training
    fine : (n,) Pa, rms of what the linear map leaves; the unit of the network's answer

    Notes
    -----
    Paper eqs. 15-16. The wanted rate enters as its change against the present one, in units of the typical
    change: their difference is what pressures decide, and it is small beside either of them.
    """

    def __init__(self, states: int, chambers: int, hidden: int) -> None:
        super().__init__()
        self.states, self.chambers = states, chambers
        rows, features = 2 * states + chambers + 3, 3 * states + 3
        sizes = {"row_mean": (rows,), "row_spread": (rows,), "change": (states,), "fine": (chambers,)}
        for name, size in sizes.items():
            self.register_buffer(name, torch.ones(size))
        self.register_buffer("linear", torch.zeros(features + 1, chambers))
        self.layers = nn.Sequential(
            nn.Linear(features, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, chambers)
        )
        nn.init.zeros_(self.layers[-1].weight)
        nn.init.zeros_(self.layers[-1].bias)

    def features(self, row: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Return (B, 3 states + 4) scaled: state, rate, tip force, wanted change, and a one."""
        scaled = (row - self.row_mean) / self.row_spread
        known = [scaled[:, : 2 * self.states], scaled[:, 2 * self.states + self.chambers :]]
        change = (wanted - row[:, self.states : 2 * self.states]) / self.change
        return torch.cat([*known, change, torch.ones_like(change[:, :1])], dim=1)

    def forward(self, row: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Return pressures (B, n) Pa for ``row`` (B, features), less its pressures, and ``wanted`` (B, states) rate."""
        features = self.features(row, wanted)
        return features @ self.linear + self.fine * self.layers(features[:, :-1])


def fit_inverse_linear(net: InverseNet, forward: ForwardNet, train: Windows, ridge: float) -> None:
    """Set the scalers of ``net`` (rows as in ``forward``) and its linear map by least squares on training windows."""
    rows, wanted = train.take(torch.arange(0, len(train), max(len(train) // 30000, 1)))
    row, at = rows[:, -1], slice(2 * net.states, 2 * net.states + net.chambers)
    net.row_mean.copy_(forward.row_mean)
    net.row_spread.copy_(forward.row_spread)
    rms = (wanted - row[:, net.states : 2 * net.states]).pow(2).mean(dim=0).sqrt()
    net.change.copy_(torch.where(rms > 0.0, rms, 1.0))
    x = net.features(row, wanted).double()
    gram = x.T @ x + ridge * len(x) * torch.eye(x.shape[1], dtype=torch.float64)
    net.linear.copy_(torch.linalg.solve(gram, x.T @ row[:, at].double()))
    left = (net.features(row, wanted) @ net.linear - row[:, at]).pow(2).mean(dim=0).sqrt()
    net.fine.copy_(left.clamp(min=1.0))


@dataclass(frozen=True)
class InverseSettings:
    """Numbers of the stage's config that this training needs; ``cycle_weight`` is beta of eq. 18."""

    hidden: int
    updates: int
    batch: int
    learning_rate: float
    cycle_weight: float
    ridge: float
    seed: int


def train_inverse(
    forward: ForwardNet, train: Windows, settings: InverseSettings, checkpoint: Checkpoint = NO_CHECKPOINT
) -> tuple[InverseNet, np.ndarray]:
    """Return the inverse of ``forward`` and the losses (updates, 2): pressure and cycle, dimensionless.

    Notes
    -----
    Paper eqs. 17-18: loss = pressure error + beta cycle error, the cycle being the rate that the frozen f_S
    predicts under the answered pressures against the wanted one.
    """
    torch.manual_seed(settings.seed)
    chambers = train.rows.shape[2] - 2 * forward.states - 3
    net = InverseNet(forward.states, chambers, settings.hidden)
    fit_inverse_linear(net, forward, train, settings.ridge)
    forward.requires_grad_(False)
    at = slice(2 * forward.states, 2 * forward.states + chambers)
    generator = torch.Generator().manual_seed(settings.seed)
    optimiser = torch.optim.AdamW(net.parameters(), lr=settings.learning_rate, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, settings.learning_rate, settings.updates + 1, pct_start=0.05
    )
    losses: dict[str, list[float]] = {"pressure": [], "cycle": []}
    training = Training(net, optimiser, schedule, generator, losses)
    checkpoint.restore(training)
    for update in progress(range(training.done, settings.updates), "f_S inverse training"):
        rows, wanted = train.take(torch.randint(len(train), (settings.batch,), generator=generator))
        pressure = net(rows[:, -1], wanted)
        data = ((pressure - rows[:, -1, at]) / net.fine).pow(2).mean()
        cycle = (
            _cycle_error(forward, rows, pressure, wanted).pow(2).mean()
            if settings.cycle_weight > 0
            else torch.zeros(())
        )
        loss = data + settings.cycle_weight * cycle
        require_finite(loss, "the inverse of f_S", update)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        losses["pressure"].append(float(data.detach()))
        losses["cycle"].append(float(cycle.detach()))
        training.done = update + 1
        checkpoint.keep(training, settings.updates)
    return net, np.array([losses["pressure"], losses["cycle"]]).T


def _cycle_error(forward: ForwardNet, rows: torch.Tensor, pressure: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """Return (f_S(window with ``pressure`` in its last row) - wanted) in units of ``forward.fine`` (B, states)."""
    last = torch.cat([rows[:, -1, : 2 * forward.states], pressure, rows[:, -1, -3:]], dim=1)
    again = torch.cat([rows[:, :-1], last[:, None]], dim=1)
    return (forward(again)[:, -1] - wanted) / forward.fine


def inverse_errors(net: InverseNet, forward: ForwardNet, heldout: Windows) -> dict[str, float]:
    """Return rms errors on held-out windows, kPa and mm/s, with those of the linear map and of the mean pressure."""
    at = slice(2 * net.states, 2 * net.states + net.chambers)
    rows, wanted = heldout.take(torch.arange(len(heldout)))
    with torch.no_grad():
        pressure, true = net(rows[:, -1], wanted), rows[:, -1, at]
        linear = net.features(rows[:, -1], wanted) @ net.linear
        cycle = _cycle_error(forward, rows, pressure, wanted) * forward.fine
    return {
        "inverse_pressure_kpa": _rms(pressure - true) / 1e3,
        "linear_inverse_pressure_kpa": _rms(linear - true) / 1e3,
        "mean_inverse_pressure_kpa": _rms(net.row_mean[at] - true) / 1e3,
        "inverse_cycle_velocity_mm_s": 1e3 * 3**0.5 * _rms(cycle[:, :3]),
    }


def _rms(error: torch.Tensor) -> float:
    return float(error.double().pow(2).mean().sqrt())


def inverse_net(artifact: InverseDynamics) -> InverseNet:
    """Return the trained network of ``artifact``."""
    net = InverseNet(8 + artifact.chambers, artifact.chambers, artifact.hidden)
    net.load_state_dict({name: torch.tensor(w) for name, w in artifact.weights.items()})
    return net.eval()
