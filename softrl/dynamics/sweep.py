"""The figure of a sweep over the physics weight and the amount of training data."""

import numpy as np
from matplotlib.figure import Figure

from softrl.core.sweep import Point, spread_by

PANELS = (
    ("position_onestep_mm", "tip error one step ahead [mm]"),
    ("position_rollout_mm", "tip error over rollouts [mm]"),
)
SPLITS = {"heldout": "unseen runs, loads as in training", "outside": "larger loads, faster programs"}


def draw(points: list[Point]) -> dict[str, Figure]:
    """Return errors over the number of training runs, a line for each physics weight, beside the linear map's."""
    weights = sorted({float(point.params["lambda"]) for point in points})
    runs = sorted({int(point.params["stage.training_runs"]) for point in points})
    if len(weights) * len(runs) < 2:
        return {}
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, squeeze=False)
    for row, (name, label) in zip(axes, PANELS, strict=True):
        for axis, (split, title) in zip(row, SPLITS.items(), strict=True):
            for k, weight in enumerate(weights):
                chosen = [point for point in points if float(point.params["lambda"]) == weight]
                _line(axis, chosen, f"{split}/{name}", f"C{k}o-", f"f_S, lambda = {weight:g}")
            _line(axis, points, f"{split}/arx_{name}", "k--", "linear map")
            axis.set(xscale="log", yscale="log", ylabel=label)
            axis.set_title(title if axis in axes[0] else "")
            axis.set_xticks(runs, [str(n) for n in runs])
            axis.minorticks_off()
    for axis in axes[1]:
        axis.set_xlabel("training runs")
    axes[0, 0].legend(fontsize=8)
    return {"physics_weight": figure}


def _line(axis: object, points: list[Point], metric: str, style: str, label: str) -> None:
    """Draw mean and spread of ``metric`` over seeds; a split that was left out has none."""
    found = spread_by(points, "stage.training_runs", metric)
    if found:
        runs, mean, spread = np.array([(float(key), *values) for key, values in found.items()]).T
        order = np.argsort(runs)
        axis.errorbar(runs[order], mean[order], spread[order], fmt=style, ms=4, lw=1.2, capsize=2, label=label)  # type: ignore[attr-defined]
