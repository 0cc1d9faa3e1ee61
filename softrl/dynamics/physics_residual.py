"""The physics in the loss: what a prediction leaves in the balance of forces of the reduced model."""

from dataclasses import dataclass

import torch

from softrl.dynamics.dataset import Body, Windows, coordinates_of
from softrl.dynamics.transformer import ForwardNet


@dataclass(frozen=True)
class PhysicsResidual:
    """Residual R of eq. 9, made dimensionless.

    Attributes
    ----------
    body : the reduced model
    rest_tip : (3,) m
    scale : (n + 3,) Pa and N, rms residual of the linear prediction on training windows
    dt_s : s
    """

    body: Body
    rest_tip: torch.Tensor
    scale: torch.Tensor
    dt_s: float

    @classmethod
    def fit(cls, body: Body, net: ForwardNet, windows: Windows, dt_s: float, samples: int, seed: int) -> "PhysicsResidual":
        """Return the residual whose scale is that of ``net``'s linear map on ``samples`` windows of the training set."""
        rest_tip = torch.tensor(body.rest_tip, dtype=torch.float64)
        unit = cls(body, rest_tip, torch.ones(body.chambers + 3, dtype=torch.float64), dt_s)
        index = torch.randint(len(windows), (samples,), generator=torch.Generator().manual_seed(seed))
        rows = windows.take(index)[0]
        with torch.no_grad():
            scale = unit(rows[:, -1], net.linear_rate(rows)[:, -1]).pow(2).mean(dim=0).sqrt()
        return cls(body, rest_tip, scale.clamp(min=1e-9), dt_s)

    def __call__(self, row: torch.Tensor, rate: torch.Tensor) -> torch.Tensor:
        """Return M a + D v + dW/dz - load (B, n + 3), over its scale, of predicted ``rate`` (B, 8 + n) after ``row``.

        Notes
        -----
        Paper eq. 9; mass, damping and elastic force, pressure and tip force are the reduced model's, evaluated at the predicted
        state and rate, with the backward difference of the rates as acceleration: the balance that implicit Euler solves.
        """
        states = rate.shape[-1]
        row, rate = row.double(), rate.double()
        now, before, load = row[:, :states], row[:, states : 2 * states], row[:, 2 * states :]
        z = coordinates_of(now + self.dt_s * rate, self.rest_tip)
        nowhere = torch.zeros(3, dtype=torch.float64)  # rates have no rest position to take off
        velocity, last = coordinates_of(rate, nowhere), coordinates_of(before, nowhere)
        return self.body.residual(z, velocity, (velocity - last) / self.dt_s, load) / self.scale
