"""The network of f_S: a causal Transformer encoder over a window, on top of a linear map of its last row."""

import numpy as np
import torch
from torch import nn

from softrl.artifacts.dynamics import ForwardDynamics


class ForwardNet(nn.Module):
    """Predicts dX/dt one step after each row of a window from that row and those before it.

    Parameters
    ----------
    states, loads : 8 + n and n + 3
    window, width, heads, layers, feedforward : size of the encoder
    linear_rows : rows that the linear map reads

    Attributes
    ----------
    row_mean, row_spread : scaler of a row
    read : (inputs,) columns of a row that the network reads
    linear : (linear_rows * inputs + 1, states) SI; what is added to the rate of ``base`` by scaled rows, newest first
    fine : (states,) SI, rms of what the linear map leaves; the unit of the Transformer's answer and of the losses

    Notes
    -----
    Paper eqs. 5-8 and 11: two encoder layers, four heads, window m, then a linear head; the axes are (batch,
    time, feature).
    Departures: of a row the network reads tip, volumes, their rates and the load only, since arc length,
    curvature and rotation follow from these (read too, they spoil rollouts as soon as they no longer fit
    together); the mask is causal, so every row of a window is a training example; the rate is predicted as the
    present one (of tip and volumes) plus a linear map, fixed by least squares before training,
    plus the Transformer, which begins at zero.
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
    ) -> None:
        super().__init__()
        features = 2 * states + loads
        own = [0, 1, 2, *range(8, states)]
        read = own + [states + i for i in own] + list(range(2 * states, features))
        self.states, self.window, self.linear_rows = states, window, linear_rows
        self.register_buffer("row_mean", torch.zeros(features))
        self.register_buffer("row_spread", torch.ones(features))
        stays = torch.zeros(states)
        stays[own] = 1.0
        self.register_buffer("stays", stays, persistent=False)
        self.register_buffer("read", torch.tensor(read), persistent=False)
        self.register_buffer("linear", torch.zeros(linear_rows * len(read) + 1, states))
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
        time = rows.shape[1]
        hidden = self.encoder(self.embed(scaled) + self.place[-time:], mask=self.mask[:time, :time], is_causal=True)
        return self._linear_rate(rows, scaled) + self.fine * self.head(hidden)

    def linear_rate(self, rows: torch.Tensor) -> torch.Tensor:
        """Return what the linear map alone predicts, (batch, rows, states) SI."""
        return self._linear_rate(rows, self.scaled(rows))

    def scaled(self, rows: torch.Tensor) -> torch.Tensor:
        """Return what the network reads of ``rows``, (batch, rows, inputs), dimensionless."""
        return ((rows - self.row_mean) / self.row_spread)[..., self.read]

    def features(self, scaled: torch.Tensor) -> torch.Tensor:
        """Return (batch, rows, linear_rows * inputs + 1): each scaled row, those before it, and a one."""
        past = [scaled]
        for _ in range(self.linear_rows - 1):
            past.append(torch.cat([past[-1][:, :1], past[-1][:, :-1]], dim=1))
        return torch.cat([*past, torch.ones_like(scaled[..., :1])], dim=2)

    def _linear_rate(self, rows: torch.Tensor, scaled: torch.Tensor) -> torch.Tensor:
        return self.base(rows) + self.features(scaled) @ self.linear

    def base(self, rows: torch.Tensor) -> torch.Tensor:
        """Return the rate that the rest adds to: the present one of tip and volumes, zero of the other states."""
        return self.stays * rows[..., self.states : 2 * self.states]


class GruNet(ForwardNet):
    """The same task with a gated recurrent network of as many weights in the Transformer's place: a baseline."""

    def __init__(
        self, states: int, loads: int, window: int, width: int, heads: int, layers: int, feedforward: int,
        linear_rows: int,
    ) -> None:  # fmt: skip
        super().__init__(states, loads, window, width, heads, layers, feedforward, linear_rows)
        weights = sum(w.numel() for w in self.encoder.parameters())
        size = max(1, round((weights / (6 * layers)) ** 0.5))  # a layer has about six squares of its size
        self.encoder = nn.GRU(size, size, layers, batch_first=True)
        self.embed, self.head = nn.Linear(self.embed.in_features, size), nn.Linear(size, states)
        self.place.requires_grad_(False)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        """Return dX/dt (batch, rows, states) SI one step after each of ``rows`` (batch, rows, features) SI."""
        scaled = self.scaled(rows)
        hidden, _ = self.encoder(self.embed(scaled))
        return self._linear_rate(rows, scaled) + self.fine * self.head(hidden)


def forward_net(artifact: ForwardDynamics) -> ForwardNet:
    """Return the trained network of ``artifact``, ready to predict."""
    net = ForwardNet(
        8 + artifact.chambers, artifact.chambers + 3, artifact.window, artifact.width, artifact.heads, artifact.layers,
        artifact.feedforward, artifact.linear_rows,
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
