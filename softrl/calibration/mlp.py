"""Training of the ensemble behind f_RS: all members at once, as one batch of small networks."""

from dataclasses import dataclass

import numpy as np
import torch

from softrl.core.progress import progress
from softrl.core.scaling import Scaler


@dataclass(frozen=True)
class EnsembleSettings:
    """Size and training of the ensemble; numbers come from the stage's config."""

    members: int
    hidden: int
    epochs: int
    learning_rate: float
    weight_decays: tuple[float, ...]
    seed: int


@dataclass(frozen=True)
class Ensemble:
    """Trained networks: stacked ``weights``, scalers (n,) Pa of input and correction, the chosen decay."""

    weights: dict[str, np.ndarray]
    pressure: Scaler
    correction_spread: np.ndarray
    weight_decay: float


def forward(weights: dict[str, torch.Tensor], scaled: torch.Tensor) -> torch.Tensor:
    """Return scaled corrections (members, rows, n) at scaled pressures (rows, n): linear part plus two tanh layers."""
    layer = scaled.expand(len(weights["skip"]), -1, -1)
    linear = layer @ weights["skip"] + weights["bias"][:, None]
    for k in ("0", "1"):
        layer = torch.tanh(layer @ weights[f"weight_{k}"] + weights[f"bias_{k}"][:, None])
    return linear + layer @ weights["weight_2"]


def fit_ensemble(pressure_real: np.ndarray, pressure_sim: np.ndarray, settings: EnsembleSettings) -> Ensemble:
    """Return networks fitted to pairs (holds, n) Pa, all of them training holds.

    Notes
    -----
    Member i never trains on every ``members``-th hold from the i-th on; those choose the epoch at which it is kept, and
    the decay of weights. Of more members than holds some leave out the same one: with none to judge it, a member would stay
    the identity.
    The spread of the members so shows both what the start and what the choice of holds leaves open. All weights of the
    last layer and the linear part start at zero and decay towards it: without data the map is the identity.
    """
    torch.set_num_threads(1)
    scaler = Scaler.fit(pressure_real)
    correction = pressure_sim - pressure_real
    spread = np.maximum(np.sqrt(np.mean(correction**2, axis=0)), 1.0)
    inputs, targets = torch.tensor(scaler.scale(pressure_real)), torch.tensor(correction / spread)
    tried = [(*_train(inputs, targets, settings, decay), decay) for decay in settings.weight_decays]
    weights, _, decay = min(tried, key=lambda one: one[1])
    return Ensemble({name: w.numpy() for name, w in weights.items()}, scaler, spread, decay)


def _initial(chambers: int, settings: EnsembleSettings) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(settings.seed)
    m, n, h = settings.members, chambers, settings.hidden

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64) / shape[-2] ** 0.5

    zeros = {"skip": (m, n, n), "bias": (m, n), "weight_2": (m, h, n), "bias_0": (m, h), "bias_1": (m, h)}
    start = {name: torch.zeros(*shape, dtype=torch.float64) for name, shape in zeros.items()}
    return start | {"weight_0": normal(m, n, h), "weight_1": normal(m, h, h)}


def _train(
    inputs: torch.Tensor, targets: torch.Tensor, settings: EnsembleSettings, weight_decay: float
) -> tuple[dict[str, torch.Tensor], float]:
    """Return the weights at each member's best epoch, and the mean squared error on what the members left out."""
    weights = {name: w.requires_grad_() for name, w in _initial(inputs.shape[1], settings).items()}
    parts = min(settings.members, len(inputs))
    turn, left = torch.arange(len(inputs)) % parts, torch.arange(settings.members) % parts
    own = turn[None] != left[:, None]  # (members, holds): what each member trains on
    optimiser = torch.optim.Adam(list(weights.values()), lr=settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.epochs)
    best = {name: w.detach().clone() for name, w in weights.items()}
    lowest = torch.full((settings.members,), torch.inf, dtype=torch.float64)
    for _ in progress(range(settings.epochs), "f_RS training"):
        optimiser.zero_grad()
        error = (forward(weights, inputs) - targets).pow(2).mean(dim=2)
        fit = (error * own).sum(dim=1) / own.sum(dim=1)
        decay = sum(w.pow(2).sum() for name, w in weights.items() if not name.startswith("bias"))
        (fit.sum() + weight_decay * decay).backward()
        judged = ((error * ~own).sum(dim=1) / (~own).sum(dim=1)).detach()
        better = judged < lowest
        for name, w in weights.items():
            best[name][better] = w.detach()[better]
        lowest = torch.where(better, judged, lowest)
        optimiser.step()
        schedule.step()
    return best, float(lowest.mean())
