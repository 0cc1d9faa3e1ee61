"""Training of f_SP and of its inverse."""

from collections.abc import Callable

import numpy as np
import torch


def train_network(
    inputs: np.ndarray,
    targets: np.ndarray,
    hidden: int,
    iterations: int,
    seed: int,
    slope: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Return the weights of a two-layer tanh network with a linear path, fitted to scaled rows by L-BFGS.

    ``slope`` (rows, m, k) is how what the targets are for changes with them, such as d tip / d joints: the error of that
    then counts as much as the error of the targets, each in units of what the linear path leaves.

    Notes
    -----
    The map is smooth and small and all rows fit in one batch: a quasi-Newton method in double precision reaches an error
    that stochastic gradients do not. The linear path starts at the least-squares map, the rest at zero.
    """
    torch.set_num_threads(1)
    weights = _initial(inputs, targets, hidden, seed)
    x, y = torch.tensor(inputs), torch.tensor(targets)
    with torch.no_grad():
        judge = _judge(_forward(weights, x) - y, None if slope is None else torch.tensor(slope))
    optimiser = torch.optim.LBFGS(
        list(weights.values()),
        max_iter=iterations,
        history_size=50,
        line_search_fn="strong_wolfe",
        tolerance_grad=1e-9,
        tolerance_change=1e-13,
    )

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = judge(_forward(weights, x) - y)
        loss.backward()
        return loss

    optimiser.step(closure)
    return {name: w.detach().numpy().copy() for name, w in weights.items()}


def _judge(first: torch.Tensor, slope: torch.Tensor | None) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return the loss of errors (rows, k); those of the linear path are ``first``."""
    if slope is None:
        return lambda error: error.pow(2).mean()

    def behind(error: torch.Tensor) -> torch.Tensor:
        return (slope @ error.unsqueeze(-1)).pow(2).mean()

    own, far = first.pow(2).mean().clamp(min=1e-30), behind(first).clamp(min=1e-30)
    return lambda error: error.pow(2).mean() / own + behind(error) / far


def _initial(inputs: np.ndarray, targets: np.ndarray, hidden: int, seed: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    n, k = inputs.shape[1], targets.shape[1]
    with_one = np.column_stack([inputs, np.ones(len(inputs))])
    linear = np.linalg.lstsq(with_one, targets, rcond=None)[0]

    def normal(rows: int, columns: int) -> torch.Tensor:
        return torch.randn(rows, columns, generator=generator, dtype=torch.float64) / rows**0.5

    start = {
        "skip": torch.tensor(linear[:-1]),
        "weight_0": normal(n, hidden), "bias_0": 0.5 * normal(1, hidden)[0],
        "weight_1": normal(hidden, hidden), "bias_1": torch.zeros(hidden, dtype=torch.float64),
        "weight_2": torch.zeros(hidden, k, dtype=torch.float64), "bias_2": torch.tensor(linear[-1]),
    }  # fmt: skip
    return {name: w.contiguous().requires_grad_() for name, w in start.items()}


def _forward(weights: dict[str, torch.Tensor], inputs: torch.Tensor) -> torch.Tensor:
    hidden = inputs
    for i in range(2):
        hidden = torch.tanh(hidden @ weights[f"weight_{i}"] + weights[f"bias_{i}"])
    return inputs @ weights["skip"] + hidden @ weights["weight_2"] + weights["bias_2"]
