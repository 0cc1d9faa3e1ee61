"""f_S^dagger: the pressures that make the wanted next rate, trained with the cycle through f_S."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from softrl.artifacts.dynamics import InverseDynamics
from softrl.core.progress import progress
from softrl.dynamics.checkpoint import NO_CHECKPOINT, Checkpoint, Training, require_finite
from softrl.dynamics.dataset import Windows
from softrl.dynamics.polynomial import MOST_SAMPLES, Polynomial, fit_ridge
from softrl.dynamics.transformer import ForwardNet


class InverseNet(nn.Module):
    """Pressures (B, n) Pa from two rows, tip force and wanted next rate: a closed form plus two tanh layers.

    Attributes
    ----------
    row_mean, row_spread, change : scalers of a row, and of the change of a rate over one step
    linear : (features, n) Pa by scaled features, fixed by least squares before training
    closed : (features + polynomials, n) Pa; the same with a polynomial of the coordinates that are wanted next
    fine : (n,) Pa, rms of what the closed form leaves; the unit of the network's answer

    Notes
    -----
    Paper eqs. 15-16. The wanted rate enters as its change against the present one, in units of the typical
    change: their difference is what pressures decide, and it is small beside either of them. Departures: the row before is
    read too, since what the body's inside still owes to earlier motion shows in it; at the coordinates where the wanted
    rate leads, the balance of forces is linear in rates and loads, which the closed form makes use of.
    """

    def __init__(self, states: int, chambers: int, hidden: int, dt_s: float, degree: int = 1) -> None:
        super().__init__()
        self.states, self.chambers, self.dt_s = states, chambers, dt_s
        rows, features = 2 * states + chambers + 3, 4 * states + chambers + 6
        sizes = {"row_mean": (rows,), "row_spread": (rows,), "change": (states,), "fine": (chambers,)}
        for name, size in sizes.items():
            self.register_buffer(name, torch.ones(size))
        own = [0, 1, 2, *range(8, states)]
        self.register_buffer("own", torch.tensor(own), persistent=False)
        drivers = 3 * len(own) + chambers + 6
        self.polynomial = Polynomial(len(own), drivers, degree)
        self.register_buffer("linear", torch.zeros(features + 1, chambers))
        self.register_buffer("closed", torch.zeros(features + 1 + self.polynomial.size, chambers))
        self.layers = nn.Sequential(
            nn.Linear(features, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, chambers)
        )
        nn.init.zeros_(self.layers[-1].weight)
        nn.init.zeros_(self.layers[-1].bias)

    def features(self, rows: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Return (B, features + 1) scaled: state, rate, tip force, wanted change, the rate and load before, and a one."""
        last, before = ((rows[:, k] - self.row_mean) / self.row_spread for k in (-1, -2))
        known = [last[:, : 2 * self.states], last[:, 2 * self.states + self.chambers :]]
        change = (wanted - rows[:, -1, self.states : 2 * self.states]) / self.change
        return torch.cat([*known, change, before[:, self.states :], torch.ones_like(change[:, :1])], dim=1)

    def coordinates(self, rows: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Return the scaled coordinates (B, n + 3) where the wanted rate leads."""
        after = rows[:, -1, : self.states] + self.dt_s * wanted
        return ((after - self.row_mean[: self.states]) / self.row_spread[: self.states])[:, self.own]

    def closed_features(self, rows: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Return ``features`` and behind them the polynomial's, (B, len(closed))."""
        plain = self.features(rows, wanted)
        return torch.cat([plain, self.polynomial(self.coordinates(rows, wanted), self.drivers(plain))], dim=1)

    def drivers(self, plain: torch.Tensor) -> torch.Tensor:
        """Return of ``features`` what comes into the balance linearly: rates of tip and volumes, loads, (B, d)."""
        n = self.states
        rate, change, before = (plain[:, at : at + n][:, self.own] for at in (n, 2 * n + 3, 3 * n + 3))
        return torch.cat([change, rate, before, plain[:, 2 * n : 2 * n + 3], plain[:, 4 * n + 3 : -1]], dim=1)

    def forward(self, rows: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Return pressures (B, n) Pa for ``rows`` (B, 2 or more, features), less the last's, and ``wanted`` (B, states)."""
        features = self.closed_features(rows, wanted)
        return features @ self.closed + self.fine * self.layers(features[:, : len(self.linear) - 1])


def fit_inverse(
    net: InverseNet, forward: ForwardNet, train: Windows, ridge: float, ridges: Sequence[float]
) -> None:
    """Set the scalers of ``net`` (rows as in ``forward``), linear map and polynomial by least squares on training windows."""
    index = torch.arange(0, len(train), max(len(train) // MOST_SAMPLES, 1))
    rows, wanted = train.take(index)
    rows, at = rows[:, -2:], slice(2 * net.states, 2 * net.states + net.chambers)
    pressure = rows[:, -1, at].double()
    net.row_mean.copy_(forward.row_mean)
    net.row_spread.copy_(forward.row_spread)
    rms = (wanted - rows[:, -1, net.states : 2 * net.states]).pow(2).mean(dim=0).sqrt()
    net.change.copy_(torch.where(rms > 0.0, rms, 1.0))
    x = net.features(rows, wanted).double()
    gram = x.T @ x + ridge * len(x) * torch.eye(x.shape[1], dtype=torch.float64)
    net.linear.copy_(torch.linalg.solve(gram, x.T @ pressure))
    net.closed.zero_()[: len(net.linear)] = net.linear
    if net.polynomial.size:
        net.polynomial.fit_range(net.coordinates(rows, wanted), net.drivers(net.features(rows, wanted)))

        def rows_of(index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
            rows, wanted = train.take(index)
            left = rows[:, -1, at] - net.features(rows, wanted) @ net.linear
            return net.closed_features(rows, wanted), left

        net.closed.add_(fit_ridge(rows_of, train, ridges))
    with torch.no_grad():
        net.fine.copy_((net(rows, wanted) - pressure).pow(2).mean(dim=0).sqrt().clamp(min=1.0))


@dataclass(frozen=True)
class InverseSettings:
    """Numbers of the stage's config that this training needs; ``cycle_weight`` is beta of eq. 18."""

    hidden: int
    updates: int
    batch: int
    learning_rate: float
    cycle_weight: float
    ridge: float
    polynomial_ridges: tuple[float, ...]
    degree: int
    dt_s: float
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
    net = InverseNet(forward.states, chambers, settings.hidden, settings.dt_s, settings.degree)
    fit_inverse(net, forward, train, settings.ridge, settings.polynomial_ridges)
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
        pressure = net(rows, wanted)
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
    return (forward.last(again) - wanted) / forward.fine


def inverse_errors(net: InverseNet, forward: ForwardNet, heldout: Windows) -> dict[str, float]:
    """Return rms errors on held-out windows, kPa and mm/s, beside linear map, closed form and mean pressure."""
    at = slice(2 * net.states, 2 * net.states + net.chambers)
    rows, wanted = heldout.take(torch.arange(len(heldout)))
    with torch.no_grad():
        pressure, true = net(rows, wanted), rows[:, -1, at]
        linear = net.features(rows, wanted) @ net.linear
        closed = net.closed_features(rows, wanted) @ net.closed
        cycle = _cycle_error(forward, rows, pressure, wanted) * forward.fine
    return {
        "inverse_pressure_kpa": _rms(pressure - true) / 1e3,
        "linear_inverse_pressure_kpa": _rms(linear - true) / 1e3,
        "polynomial_inverse_pressure_kpa": _rms(closed - true) / 1e3,
        "mean_inverse_pressure_kpa": _rms(net.row_mean[at] - true) / 1e3,
        "inverse_cycle_velocity_mm_s": 1e3 * 3**0.5 * _rms(cycle[:, :3]),
    }


def _rms(error: torch.Tensor) -> float:
    return float(error.double().pow(2).mean().sqrt())


def inverse_net(artifact: InverseDynamics) -> InverseNet:
    """Return the trained network of ``artifact``."""
    a = artifact
    net = InverseNet(8 + a.chambers, a.chambers, a.hidden, a.dt_s, a.polynomial_degree)
    net.load_state_dict({name: torch.tensor(w) for name, w in artifact.weights.items()})
    return net.eval()
