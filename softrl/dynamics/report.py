"""What is logged of f_S: how much motion it saw, and its errors beside those of the baselines."""

import numpy as np
import torch

from softrl.artifacts.snapshots import Snapshots
from softrl.core.tracking import Tracker
from softrl.dynamics.dataset import Windows
from softrl.dynamics.evaluate import Predictor, onestep_errors, rollout, rollout_errors
from softrl.dynamics.figures import draw_rollout, table
from softrl.dynamics.physics_residual import PhysicsResidual
from softrl.dynamics.sets import SetSettings
from softrl.dynamics.transformer import ForwardNet


def report_samples(settings: SetSettings, snapshots: Snapshots, tracker: Tracker) -> tuple[int, float]:
    """Log and return how many samples train, and the share of all that the full model made: they test, none of them trains."""
    steps = settings.rows - 1
    reduced = steps * (settings.training_runs + settings.validation_runs + settings.heldout_runs)
    full = snapshots.trajectory_load.shape[0] * snapshots.trajectory_load.shape[1]
    training, share = steps * settings.training_runs, full / (full + reduced)
    tracker.metric("training_samples", training)
    tracker.metric("reduced_model_samples", reduced)
    tracker.metric("full_order_samples", full)
    tracker.metric("full_order_share_pct", 100.0 * share)
    return training, share


def residual_shares(net: ForwardNet, physics: PhysicsResidual, heldout: Windows) -> tuple[float, float]:
    """Return the rms physics residual on held-out windows of f_S, and of the motions; 1 is that of the linear prediction."""
    rows, true = heldout.take(torch.arange(len(heldout)))
    with torch.no_grad():
        linear = net.linear_rate(rows[:, -net.linear_rows :])[:, -1]
        own, least, plain = (physics(rows, rate).pow(2).mean(dim=0) for rate in (net.last(rows), true, linear))
    shares = [float((part / plain.clamp(min=1e-30)).mean().sqrt()) for part in (own, least)]
    return shares[0], shares[1]


def report_errors(
    split: str, known: dict[str, Predictor], windows: Windows, dt_s: float, rollout_s: float, tracker: Tracker
) -> None:
    """Log the errors of all that predict, one step ahead and over ``rollout_s``, with a table and a figure of one run."""
    steps = min(round(rollout_s / dt_s), windows.per_run)
    errors = {
        name: onestep_errors(predict, windows, dt_s) | rollout_errors(predict, windows, steps, dt_s)
        for name, predict in known.items()
    }
    for name, values in errors.items():
        for key, value in values.items():
            # the reduced model made these runs and predicts no rotation: what it would score there says nothing
            if name != "rom" or (split == "full_model" and "orientation" not in key):
                tracker.metric(f"{split}/{key}" if name == "f_s" else f"{split}/{name}_{key}", value)
    tracker.text(f"errors_{split}.md", table(errors))
    first = torch.tensor([0])
    paths = {name: rollout(known[name], windows, first, windows.per_run, dt_s) for name in ("f_s", "arx")}
    time = dt_s * np.arange(1, windows.per_run + 1)
    states = {name: path[0][0] for name, path in paths.items()}
    tracker.figure(
        f"rollout_{split}", draw_rollout(time, states, paths["f_s"][1][0], f"whole run, {split.replace('_', ' ')}")
    )
