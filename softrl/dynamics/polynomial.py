"""Polynomials of a body's coordinates times what drives it: the closed-form part of f_S and of its inverse."""

from collections.abc import Callable, Sequence
from itertools import combinations_with_replacement

import torch
from torch import nn

from softrl.dynamics.dataset import Windows

MOST_SAMPLES = 40_000  # that a least-squares fit reads
LEFT_OUT = 4  # every so many runs one chooses the ridge; of fewer runs their last part of as many
Rows = Callable[[torch.Tensor], tuple[torch.Tensor, torch.Tensor]]  # index -> features (B, f), targets (B, k)


class Polynomial(nn.Module):
    """Monomials of scaled coordinates z (..., m) up to ``degree``, those below it also times each driver u (..., d).

    Attributes
    ----------
    low, high : (m + d,) range of z and u in training; beyond it both are held, so that no product is trusted outside its
        samples

    Notes
    -----
    In a balance of forces M(z) a + D(z) v + dW/dz = load the rates and loads come in linearly, each times a function of
    the coordinates: products of one driver with a polynomial of z are its terms.
    """

    def __init__(self, coordinates: int, drivers: int, degree: int) -> None:
        super().__init__()
        self.register_buffer("low", torch.zeros(coordinates + drivers))
        self.register_buffer("high", torch.zeros(coordinates + drivers))
        self.degree = degree
        levels = [list(combinations_with_replacement(range(coordinates), d)) for d in range(1, degree + 1)]
        for d, level in enumerate(levels, 1):
            self.register_buffer(f"level_{d}", torch.tensor(level), persistent=False)
        counts = [len(level) for level in levels]
        self.size = sum(counts[1:]) + drivers * sum(counts[:-1])

    def fit_range(self, coordinates: torch.Tensor, drivers: torch.Tensor) -> None:
        """Set the range beyond which coordinates (rows, m) and drivers (rows, d) are held."""
        both = torch.cat([coordinates, drivers], dim=-1)
        self.low.copy_(both.amin(dim=0))
        self.high.copy_(both.amax(dim=0))

    def forward(self, coordinates: torch.Tensor, drivers: torch.Tensor) -> torch.Tensor:
        """Return the features (..., size), those that are linear in either left out."""
        both = torch.cat([coordinates, drivers], dim=-1)
        both = torch.minimum(torch.maximum(both, self.low), self.high)
        held, drivers = both.split([coordinates.shape[-1], drivers.shape[-1]], dim=-1)
        levels = [held[..., getattr(self, f"level_{d}")].prod(dim=-1) for d in range(1, self.degree + 1)]
        if not levels[1:]:
            return held[..., :0]
        lower = torch.cat(levels[:-1], dim=-1)
        products = (lower.unsqueeze(-1) * drivers.unsqueeze(-2)).flatten(-2)
        return torch.cat([*levels[1:], products], dim=-1)


def fit_ridge(
    rows_of: Rows, windows: Windows, ridges: Sequence[float], judge: Callable[[torch.Tensor], float] | None = None
) -> torch.Tensor:
    """Return the coefficients (f, k) of least squares on windows, with that of ``ridges`` which errs least on runs left out.

    A ridge is relative to the mean square of a feature; coefficients of zero are a candidate too. ``judge`` tells the error
    of coefficients from the other runs; without it that of the targets counts.
    """
    step = max(len(windows) // MOST_SAMPLES, 1)
    index = torch.arange(step // 2, len(windows), step)
    out = left_out(index, windows)
    seen, unseen = _moments(rows_of, index[~out]), _moments(rows_of, index[out])
    error = judge or (lambda coefficients: _squared(unseen, coefficients))
    tried = [(torch.inf, error(torch.zeros_like(seen[1])))]
    tried += [(ridge, error(_solved(seen, ridge))) for ridge in ridges]
    best = min((one for one in tried if one[1] == one[1]), key=lambda one: one[1])[0]  # nan where a rollout ran away
    both = tuple(a + b for a, b in zip(seen, unseen, strict=True))
    return torch.zeros_like(both[1]) if best == torch.inf else _solved(both, best)


def left_out(index: torch.Tensor, windows: Windows) -> torch.Tensor:
    """Return (B,) bool: whether the window ``index`` (B,) lies in what chooses the ridge."""
    run, at = index // windows.per_run, index % windows.per_run
    if len(windows) < LEFT_OUT * windows.per_run:
        return at >= windows.per_run - windows.per_run // LEFT_OUT
    return run % LEFT_OUT == LEFT_OUT - 1


def _moments(rows_of: Rows, index: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Return X'X, X'Y scaled, the targets' own squares, and the number of rows."""
    gram, moment, square = torch.zeros(()), torch.zeros(()), torch.zeros(())
    for part in index.split(4096):
        x, y = (values.double() for values in rows_of(part))
        gram, moment, square = gram + x.T @ x, moment + x.T @ y, square + y.pow(2).sum(dim=0)
    return gram, moment, square, torch.tensor(len(index))


def _solved(moments: tuple[torch.Tensor, ...], ridge: float) -> torch.Tensor:
    gram, moment, _, _ = moments
    level = ridge * gram.diagonal().mean()
    return torch.linalg.solve(gram + level * torch.eye(len(gram), dtype=gram.dtype), moment)


def _squared(moments: tuple[torch.Tensor, ...], coefficients: torch.Tensor) -> float:
    """Return the mean square that ``coefficients`` leave, each target in units of its own."""
    gram, moment, square, _ = moments
    left = square - 2.0 * (coefficients * moment).sum(dim=0) + (coefficients * (gram @ coefficients)).sum(dim=0)
    return float((left / square.clamp(min=1e-30)).mean())
