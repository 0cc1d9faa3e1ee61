"""Figures of the learned dynamics: losses, a rollout over the truth, and the table of errors."""

import numpy as np
from matplotlib.figure import Figure

from softrl.dynamics.training import History


def draw_losses(history: History, onestep_updates: int, inverse: np.ndarray) -> Figure:
    """Return the losses of f_S (data, physics, validation) and of its inverse (updates, 2), over 50 updates.

    After ``onestep_updates`` the data are rollouts, whose loss counts the drift too and has another scale.
    """
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    forward, backward = figure.subplots(1, 2)
    for part, label in ((slice(onestep_updates), "data, one step"), (slice(onestep_updates, None), "data, rollouts with drift")):
        losses = history.data[part]
        if len(losses):
            forward.semilogy(np.arange(len(history.data))[part][-len(_smooth(losses)) :], _smooth(losses), label=label)
    if np.isfinite(history.physics).all():
        forward.semilogy(_smooth(history.physics), label="physics residual")
    forward.semilogy(history.validation_update, history.validation, "k.-", lw=0.8, ms=3, label="validation, one step")
    forward.axhline(1.0, color="0.6", lw=0.8, label="closed form, one step")
    forward.set(xlabel="update", ylabel="loss", title="f_S")
    backward.semilogy(_smooth(inverse[:, 0]), label="pressure")
    if inverse[:, 1].any():
        backward.semilogy(_smooth(inverse[:, 1]), label="cycle through f_S")
    backward.set(xlabel="update", title="inverse of f_S")
    forward.legend(fontsize=8)
    backward.legend(fontsize=8)
    return figure


def draw_rollout(time: np.ndarray, paths: dict[str, np.ndarray], true: np.ndarray, title: str) -> Figure:
    """Return tip coordinates of predicted ``paths`` (name -> (steps, states)) over the true states (steps, states)."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    for i, name in enumerate("xyz"):
        axes[i].plot(time, 1e3 * true[:, i], "k", lw=2.0, label="truth")
        for path, style in zip(paths, ("r-", "b--", "g:"), strict=False):
            axes[i].plot(time, 1e3 * paths[path][:, i], style, lw=1.0, label=path)
        axes[i].set_ylabel(f"tip {name} [mm]")
        # a baseline that runs away must not flatten the rest
        low, high = 1e3 * true[:, i].min(), 1e3 * true[:, i].max()
        axes[i].set_ylim(low - 0.3 * (high - low) - 0.5, high + 0.3 * (high - low) + 0.5)
    for path, style in zip(paths, ("r-", "b--", "g:"), strict=False):
        axes[3].semilogy(
            time, 1e3 * np.linalg.norm(paths[path][:, :3] - true[:, :3], axis=1), style, lw=1.0, label=path
        )
    axes[3].set(xlabel="time [s]", ylabel="tip error [mm]")
    axes[0].legend(fontsize=8, ncols=4)
    axes[0].set_title(title)
    return figure


def table(errors: dict[str, dict[str, float]]) -> str:
    """Return errors (row -> column -> value) as a Markdown table."""
    columns = list(next(iter(errors.values())))
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for row, values in errors.items():
        lines.append(f"| {row} | " + " | ".join(f"{values[c]:.4g}" if c in values else "-" for c in columns) + " |")
    return "\n".join(lines) + "\n"


def _smooth(values: np.ndarray) -> np.ndarray:
    width = min(50, max(len(values) // 10, 1))
    return np.convolve(values, np.full(width, 1.0 / width), mode="valid")
