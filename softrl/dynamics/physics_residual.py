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
    flexibility : (n + 3, n + 3) change of the rate of z per residual force, through the tangent of implicit
        Euler at rest
    scale : (n + 3,) rms of ``flexibility`` R for the closed form's prediction on training windows, m^3/s and m/s
    dt_s : s

    Notes
    -----
    Departure: forces are weighed by the rate that they would still change. Weighed by their own size, the stiff
    combinations of volumes and tip rule the sum, and a larger lambda then made every prediction worse.
    """

    body: Body
    flexibility: torch.Tensor
    scale: torch.Tensor
    dt_s: float

    @classmethod
    def fit(
        cls, body: Body, net: ForwardNet, windows: Windows, dt_s: float, samples: int, seed: int
    ) -> "PhysicsResidual":
        """Return the residual, scaled by that of ``net``'s closed form on ``samples`` training windows."""
        size = body.chambers + 3
        unit = cls(body, _flexibility(body, dt_s), torch.ones(size, dtype=torch.float64), dt_s)
        index = torch.randint(len(windows), (samples,), generator=torch.Generator().manual_seed(seed))
        rows = windows.take(index)[0]
        with torch.no_grad():
            scale = unit(rows, net.closed_rate(rows[:, -net.linear_rows :])[:, -1]).pow(2).mean(dim=0).sqrt()
        return cls(body, unit.flexibility, torch.where(scale > 0.0, scale, 1.0), dt_s)

    def __call__(self, rows: torch.Tensor, rate: torch.Tensor) -> torch.Tensor:
        """Return the dimensionless residual (B, n + 3) of predicted ``rate`` (B, 8 + n) after ``rows`` (B, window, features)."""
        return self.force(rows, rate) @ self.flexibility.T / self.scale

    def force(self, rows: torch.Tensor, rate: torch.Tensor) -> torch.Tensor:
        """Return M a + D v + dW/dz - load (B, n + 3), Pa and N, of predicted ``rate`` (B, 8 + n) after ``rows``.

        Notes
        -----
        Paper eq. 9; mass, damping and elastic force, weight, pressure and tip force are the reduced model's, in the balance of
        its own step to the predicted state: zero for its motions, but for what its inside still remembers of the time before
        the window.
        """
        states = rate.shape[-1]
        rows, rate = rows.double(), rate.double()
        # positions before now by rates, which single precision resolves better than differences of positions
        travelled = self.dt_s * torch.cat([rows[:, :, states : 2 * states], rate[:, None]], dim=1).cumsum(dim=1)
        start = rows[:, -1:, :states] - travelled[:, -2:-1]
        path = torch.cat([start, start + travelled], dim=1)
        return self.body.residual(coordinates_of(path, torch.tensor(self.body.rest_tip)), rows[:, -1, 2 * states :], self.dt_s)


def _flexibility(body: Body, dt_s: float) -> torch.Tensor:
    rest = torch.tensor(body.rest)

    def residual(velocity: torch.Tensor) -> torch.Tensor:
        path = torch.stack([rest, rest, rest + dt_s * velocity])[None]
        return body.residual(path, torch.zeros_like(path[:, 0]), dt_s)[0]

    tangent = torch.autograd.functional.jacobian(residual, torch.zeros_like(rest))
    return torch.linalg.inv(tangent)
