"""Figures of rollouts and of the identification's programs."""

import numpy as np
from matplotlib.figure import Figure

from softrl.recordings.recording import Recording
from softrl.sim2real.rollout import Rollout


def draw_rollouts(rollouts: dict[str, dict[str, Rollout]]) -> Figure:
    """Return one column a shape: paths seen from above and the error at each command, one line a controller."""
    figure = Figure(figsize=(4.2 * len(rollouts), 6.0), layout="constrained")
    axes = figure.subplots(2, len(rollouts), squeeze=False, gridspec_kw={"height_ratios": [3, 1]})
    for (shape, runs), path, error in zip(rollouts.items(), axes[0], axes[1], strict=True):
        target = next(iter(runs.values())).target
        path.plot(*(1e3 * target[:, :2].T), "k--", lw=1.0, label="target")
        for controller, rollout in runs.items():
            distance_mm = 1e3 * np.linalg.norm(rollout.reached - target, axis=1)
            path.plot(*(1e3 * rollout.reached[:, :2].T), ".-", lw=1.0, ms=3, label=controller.replace("_", " "))
            error.plot(distance_mm, lw=1.0)
        path.set(title=shape.replace("_", " "), xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
        error.set(xlabel="command", ylabel="error (mm)", ylim=(0.0, None))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def draw_session(recording: Recording) -> Figure:
    """Return the commands of a session and the motion that followed."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for i in range(recording.pressure_cmd.shape[1]):
        top.plot(recording.time, 1e-3 * recording.pressure_cmd[:, i], lw=0.8, label=f"chamber {i + 1}")
    top.set(ylabel="command (kPa)", title=recording.name.replace("_", " "))
    if recording.position is not None:
        for i, axis in enumerate("xyz"):
            bottom.plot(recording.time, 1e3 * (recording.position[:, i] - recording.position[0, i]), lw=0.8, label=axis)
    bottom.set(xlabel="time (s)", ylabel="tip from start (mm)")
    top.legend(fontsize="small", ncols=3)
    bottom.legend(fontsize="small", ncols=3)
    return figure
