"""Figures of rollouts, of a disturbance, of the bandwidth and of the identification's programs."""

import numpy as np
from matplotlib.figure import Figure

from softrl.recordings.recording import Recording
from softrl.sim2real.bandwidth import KNEE, Response
from softrl.sim2real.disturbance import BACK, Disturbance, recovery
from softrl.sim2real.rollout import Rollout


def draw_rollouts(rollouts: dict[str, dict[str, Rollout]]) -> Figure:
    """Return one column a course: paths seen from above, the errors at each command, and on a surface the forces."""
    courses = [next(iter(runs.values())).course for runs in rollouts.values()]
    rows = 2 if courses[0].frame is None else 3
    figure = Figure(figsize=(4.2 * len(rollouts), 6.0 + 2.0 * (rows - 2)), layout="constrained")
    axes = figure.subplots(rows, len(rollouts), squeeze=False, gridspec_kw={"height_ratios": [3, *(rows - 1) * [1.2]]})
    for course, runs, (path, error, *force) in zip(courses, rollouts.values(), axes.T, strict=True):
        path.plot(*(1e3 * course.position[:, :2].T), "k--", lw=1.0, label="target", zorder=9)
        for controller, rollout in runs.items():
            path.plot(*(1e3 * rollout.reached[:, :2].T), ".-", lw=1.0, ms=3, label=controller.replace("_", " "))
            error.semilogy(1e3 * course.position_error(rollout.reached), lw=1.0)
            for axis in force:
                axis.plot(rollout.pressed, lw=1.0)
        for axis in force:
            axis.plot(course.force, "k--", lw=1.0, zorder=9)
            axis.set(xlabel="command", ylabel="force (N)")
        path.set(title=course.name.replace("_", " "), xlabel="x (mm)", ylabel="y (mm)")
        path.set_aspect("equal", adjustable="datalim")
        error.set(xlabel="command", ylabel="error (mm)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def draw_recovery(rollouts: dict[str, Rollout], disturbance: Disturbance, period_s: float) -> Figure:
    """Return the error over time of each controller, the time without the air line shaded."""
    figure = Figure(figsize=(7.0, 3.5), layout="constrained")
    axes = figure.subplots()
    for controller, rollout in rollouts.items():
        error_mm = 1e3 * rollout.course.position_error(rollout.reached)
        cut, back = disturbance.steps(len(error_mm), period_s)
        (line,) = axes.semilogy(period_s * np.arange(1, len(error_mm) + 1), error_mm, lw=1.0, label=controller)
        before = recovery(rollout, cut, back, period_s).before_mm
        axes.axhline(BACK * before, color=line.get_color(), ls=":", lw=0.8)
    axes.axvspan(period_s * cut, period_s * back, color="0.9", label=f"air line {disturbance.chamber + 1} off")
    axes.set(xlabel="time (s)", ylabel="error (mm)", title=f"dotted: {BACK:g} times the error before")
    axes.legend(fontsize="small")
    return figure


def draw_bandwidth(measured: Response, predicted: dict[str, Response]) -> Figure:
    """Return amplitude over frequency, measured and predicted with and without single effects."""
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for name, found in predicted.items():
        style = {"lw": 1.6} if name == "predicted" else {"lw": 0.9, "ls": "--"}
        axes.loglog(found.frequency_hz, found.ratio, label=name.replace("_", " "), **style)
    axes.loglog(measured.frequency_hz, measured.ratio, "ko", ms=4, label="measured")
    axes.axhline(KNEE, color="0.5", lw=0.8, ls=":")
    axes.set(xlabel="frequency (Hz)", ylabel="amplitude over that of the slowest tone", title="dotted: -3 dB")
    axes.legend(fontsize="small")
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
