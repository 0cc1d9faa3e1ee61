"""Pictures of laps and of training."""

import numpy as np
from matplotlib.figure import Figure

from softrl.rl.evaluate import Evaluation
from softrl.rl.reward import weigh
from softrl.rl.tasks.task import Task
from softrl.surrogate.twin import Plane


def draw_laps(laps: dict[str, Evaluation], plane: Plane | None) -> Figure:
    """Return the first lap over each evaluation curve: path from above, and below it heights, or forces on a surface."""
    figure = Figure(figsize=(3.6 * len(laps), 6.2), layout="constrained")
    axes = figure.subplots(2, len(laps), squeeze=False)
    for (curve, lap), (above, below) in zip(laps.items(), axes.T, strict=True):
        tip, target = 1e3 * lap.tip[:, 0], 1e3 * lap.target[:, 0]
        above.plot(target[:, 0], target[:, 1], "-", color="0.6", lw=2.5, label="target")
        above.plot(tip[:, 0], tip[:, 1], ".-", color="C0", ms=3, lw=0.7, label="tip")
        title = f"{curve.replace('_', ' ')}: {1e3 * lap.position_rmse:.2f} mm rms"
        above.set(xlabel="x in mm", ylabel="y in mm", title=title)
        above.set_aspect("equal", adjustable="datalim")
        steps = np.arange(1, len(tip) + 1)
        wanted, got, label = (target[:, 2], tip[:, 2], "z in mm")
        if plane is not None:
            wanted, got, label = lap.wanted_force[:, 0], lap.contact_force[:, 0], "normal force in N"
        below.plot(steps, wanted, "-", color="0.6", lw=2.5)
        below.plot(steps, got, ".-", color="C0", ms=3, lw=0.7)
        below.set(xlabel="step", ylabel=label)
    axes[0, 0].legend(frameon=False, fontsize=8)
    return figure


def draw_reward(task: Task) -> Figure:
    """Return R_q over the position error and R_F over the force error, each as the task pays it by itself."""
    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    shapes = (
        ("R_q", 1.0, task.position_scale_m, 1e3, "position error [mm]"),
        ("R_F", 0.0, task.force_scale_n, 1.0, "force error [N]"),
    )
    for axis, (name, alpha, scale, unit, label) in zip(figure.subplots(1, 2, sharey=True), shapes, strict=True):
        error = np.linspace(0.0, 15.0 * scale, 400)
        zero = np.zeros_like(error)
        apart = (error, zero) if name == "R_q" else (zero, error)
        axis.plot(unit * error, weigh(alpha, *apart, task.position_scale_m, task.force_scale_n))
        axis.axvline(unit * scale, color="0.6", lw=0.8, ls="--", label=f"scale, {unit * scale:g}")
        share = task.alpha if name == "R_q" else 1.0 - task.alpha
        axis.set(xlabel=label, title=f"{name}, weight {share:g} in R", ylim=(0.0, 1.02))
        axis.legend(frameon=False, fontsize=8)
    figure.axes[0].set_ylabel("reward")
    return figure


def draw_history(history: list[tuple[int, float]]) -> Figure:
    """Return the validation reward over training; the best point is what the stage keeps."""
    figure = Figure(figsize=(5.0, 3.0), layout="constrained")
    axis = figure.subplots()
    steps, rewards = zip(*history, strict=True)
    axis.plot(steps, rewards, ".-")
    best = len(rewards) - 1 - int(np.nanargmax(rewards[::-1]))  # of equal ones the last
    axis.plot(steps[best], rewards[best], "o", mfc="none", ms=10, color="C1", label="kept")
    axis.set(xlabel="steps or epochs", ylabel="mean reward on random curves", ylim=(0.0, 1.02))
    axis.legend(frameon=False)
    return figure
