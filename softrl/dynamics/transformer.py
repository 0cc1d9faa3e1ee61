"""The network of f_S: a causal Transformer encoder over a window, on top of a polynomial of its last rows."""

import numpy as np
import torch
from torch import nn

from softrl.artifacts.dynamics import ForwardDynamics
from softrl.dynamics.polynomial import Polynomial


class ForwardNet(nn.Module):
    """Predicts dX/dt one step after each row of a window from that row and those before it.

    Parameters
    ----------
    states, loads : 8 + n and n + 3
    window, width, heads, layers, feedforward : size of the encoder
    linear_rows : rows that the linear map and the polynomial read
    degree : of the polynomial in the coordinates; 1 for the linear map alone

    Attributes
    ----------
    row_mean, row_spread : scaler of a row
    read : (inputs,) columns of a row that the network reads
    linear : (linear_rows * inputs + 1, states) SI; what is added to the rate of ``base`` by scaled rows, newest first
    closed : (linear_rows * inputs + 1 + polynomials, states) SI; the same with the polynomial of the coordinates
    step_s : s, from a row to where the polynomial is taken
    fine : (states,) SI, rms of what the closed form leaves; the unit of the Transformer's answer and of the losses

    Notes
    -----
    Paper eqs. 5-8 and 11: two encoder layers, four heads, window m, then a linear head; the axes are (batch,
    time, feature).
    Departures: of a row the network reads tip, volumes, their rates and the load only, since arc length,
    curvature and rotation follow from these (read too, they spoil rollouts as soon as they no longer fit
    together); the mask is causal, so every row of a window is a training example; the rate is predicted as the
    present one (of tip and volumes) plus a closed form, linear in rates and loads and a polynomial in the coordinates,
    fixed by least squares before training, plus the Transformer, which begins at zero.
    """

    def __init__(
        self,
        states: int,
        loads: int,
        window: int,
        width: int,
        heads: int,
        layers: int,
        feedforward: int,
        linear_rows: int,
        degree: int = 1,
    ) -> None:
        super().__init__()
        features = 2 * states + loads
        own = [0, 1, 2, *range(8, states)]
        read = own + [states + i for i in own] + list(range(2 * states, features))
        self.states, self.window, self.linear_rows, self.coordinates = states, window, linear_rows, len(own)
        self.register_buffer("row_mean", torch.zeros(features))
        self.register_buffer("row_spread", torch.ones(features))
        stays = torch.zeros(states)
        stays[own] = 1.0
        self.register_buffer("stays", stays, persistent=False)
        self.register_buffer("read", torch.tensor(read), persistent=False)
        self.register_buffer("own", torch.tensor(own), persistent=False)
        self.register_buffer("linear", torch.zeros(linear_rows * len(read) + 1, states))
        drivers = linear_rows * (len(read) - len(own))
        self.polynomial = Polynomial(len(own), drivers, degree)
        self.register_buffer("closed", torch.zeros(len(self.linear) + self.polynomial.size, states))
        self.register_buffer("step_s", torch.zeros(()))
        self.register_buffer("fine", torch.ones(states))
        self.embed = nn.Linear(len(read), width)
        self.place = nn.Parameter(0.02 * torch.randn(window, width))
        layer = nn.TransformerEncoderLayer(width, heads, feedforward, dropout=0.0, batch_first=True, norm_first=True)
        self.encoder = nn.TransformerEncoder(layer, layers, norm=nn.LayerNorm(width), enable_nested_tensor=False)
        self.head = nn.Linear(width, states)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        self.register_buffer("mask", nn.Transformer.generate_square_subsequent_mask(window), persistent=False)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return dX/dt (batch, rows, states) SI one step after each of ``rows`` (batch, rows, features) SI."""
        scaled = self.scaled(rows)
        return self._closed_rate(rows, scaled) + self.fine * self.head(self.encoded(scaled))

    def last(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the last of what ``forward`` returns, (batch, states) SI, without the closed form of the rows before."""
        scaled, near = self.scaled(rows), slice(-self.linear_rows, None)
        closed = self._closed_rate(rows[:, near], scaled[:, near])[:, -1]
        return closed + self.fine * self.head(self.encoded(scaled)[:, -1])

    def encoded(self, scaled: torch.Tensor) -> torch.Tensor:
        """Return what the encoder makes of scaled rows (batch, rows, inputs), (batch, rows, width)."""
        time = scaled.shape[1]
        return self.encoder(self.embed(scaled) + self.place[-time:], mask=self.mask[:time, :time], is_causal=True)

    def closed_rate(self, rows: torch.Tensor) -> torch.Tensor:
        """Return what the closed form alone predicts, (batch, rows, states) SI."""
        return self._closed_rate(rows, self.scaled(rows))

    def linear_rate(self, rows: torch.Tensor) -> torch.Tensor:
        """Return what the linear map alone predicts, (batch, rows, states) SI."""
        return self.base(rows) + self.features(self.scaled(rows)) @ self.linear

    def scaled(self, rows: torch.Tensor) -> torch.Tensor:
        """Return what the network reads of ``rows``, (batch, rows, inputs), dimensionless."""
        return ((rows - self.row_mean) / self.row_spread)[..., self.read]

    def features(self, scaled: torch.Tensor) -> torch.Tensor:
        """Return (batch, rows, linear_rows * inputs + 1): each scaled row, those before it, and a one."""
        past = [scaled]
        for _ in range(self.linear_rows - 1):
            past.append(torch.cat([past[-1][:, :1], past[-1][:, :-1]], dim=1))
        return torch.cat([*past, torch.ones_like(scaled[..., :1])], dim=2)

    def closed_features(self, rows: torch.Tensor, scaled: torch.Tensor) -> torch.Tensor:
        """Return ``features`` and behind them the polynomial's, (batch, rows, len(closed))."""
        plain = self.features(scaled)
        return torch.cat([plain, self.polynomial(*self.terms(rows, plain))], dim=-1)

    def terms(self, rows: torch.Tensor, plain: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return where the linear map leads, scaled (batch, rows, n + 3), and the rates and loads of all rows in ``plain``.

        The balance of forces holds where a step ends, so there its functions of the coordinates are to be taken.
        """
        by_row = plain[..., :-1].unflatten(-1, (self.linear_rows, -1))
        drivers = by_row[..., self.coordinates :].flatten(-2)
        rate = (self.base(rows) + plain @ self.linear)[..., self.own]
        return by_row[..., 0, : self.coordinates] + self.step_s * rate / self.row_spread[self.own], drivers

    def _closed_rate(self, rows: torch.Tensor, scaled: torch.Tensor) -> torch.Tensor:
        return self.base(rows) + self.closed_features(rows, scaled) @ self.closed

    def base(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the rate that the rest adds to: the present one of tip and volumes, zero of the other states."""
        return self.stays * rows[..., self.states : 2 * self.states]


class GruNet(ForwardNet):
    """The same task with a gated recurrent network of as many weights in the Transformer's place: a baseline."""

    def __init__(
        self, states: int, loads: int, window: int, width: int, heads: int, layers: int, feedforward: int,
        linear_rows: int, degree: int = 1,
    ) -> None:  # fmt: skip
        super().__init__(states, loads, window, width, heads, layers, feedforward, linear_rows, degree)
        weights = sum(w.numel() for w in self.encoder.parameters())
        size = max(1, round((weights / (6 * layers)) ** 0.5))  # a layer has about six squares of its size
        self.encoder = nn.GRU(size, size, layers, batch_first=True)
        self.embed, self.head = nn.Linear(self.embed.in_features, size), nn.Linear(size, states)
        self.place.requires_grad_(False)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def encoded(self, scaled: torch.Tensor) -> torch.Tensor:
        """Return what the recurrent network makes of scaled rows (batch, rows, inputs), (batch, rows, its size)."""
        hidden: torch.Tensor = self.encoder(self.embed(scaled))[0]
        return hidden


def forward_net(artifact: ForwardDynamics) -> ForwardNet:
    """Return the trained network of ``artifact``, ready to predict."""
    net = ForwardNet(
        8 + artifact.chambers, artifact.chambers + 3, artifact.window, artifact.width, artifact.heads, artifact.layers,
        artifact.feedforward, artifact.linear_rows, artifact.polynomial_degree,
    )  # fmt: skip
    net.load_state_dict({name: torch.tensor(w) for name, w in artifact.weights.items()})
    return net.eval()


def weights_of(net: nn.Module) -> dict[str, np.ndarray]:
    """Return the state_dict as arrays."""
    return {name: w.detach().numpy().copy() for name, w in net.state_dict().items()}


def advance(rows: torch.Tensor, rate: torch.Tensor, next_load: torch.Tensor, dt_s: float) -> torch.Tensor:
    """Return the window one step on: its last state moved by ``rate`` (B, states), then ``next_load`` held."""
    states = rate.shape[-1]
    moved = rows[:, -1, :states] + dt_s * rate
    last = torch.cat([moved, rate, next_load], dim=-1)
    return torch.cat([rows[:, 1:], last[:, None]], dim=1)
