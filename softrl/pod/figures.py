"""Figures of the reduction: spectrum, choice of the energy, static parity, motion beside the full model's."""

import numpy as np
from matplotlib.figure import Figure

from softrl.pod.convergence import Point
from softrl.pod.fitting.candidates import Choice
from softrl.pod.report import Prediction


def draw_spectrum(singular_values: np.ndarray, modes: int, train_m: np.ndarray, heldout_m: np.ndarray) -> Figure:
    """Return singular values, and projection errors (modes + 1,) m on seen and unseen snapshots."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    number = np.arange(1, len(singular_values) + 1)
    left.semilogy(number, singular_values / singular_values[0], "k.-", ms=4, lw=0.8)
    left.axvline(modes + 0.5, color="r", lw=0.8, label=f"kept: {modes}")
    left.set(xlabel="mode", ylabel="singular value / first", title="POD spectrum, mass-weighted")
    left.set_ylim(bottom=max(float(singular_values[-1] / singular_values[0]), 1e-8))
    left.legend(fontsize=8)
    for errors, label, style in ((train_m, "seen", "0.6"), (heldout_m, "held out", "r")):
        right.semilogy(np.arange(len(errors)), 1e3 * errors, ".-", color=style, label=label)
    right.set(xlabel="modes", ylabel="rms distance of nodes [mm]", title="projection error")
    right.legend(fontsize=8)
    return figure


def draw_choice(choices: list[Choice]) -> Figure:
    """Return the cross-validated tip error over the degree of the energy, by weight of images, at the best ridge."""
    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    axes = figure.subplots()
    degrees = sorted({choice.degree for choice in choices})
    for weight in sorted({choice.image_weight for choice in choices}):
        same = [choice for choice in choices if choice.image_weight == weight]
        tried = sorted({choice.degree for choice in same})  # a body that had to be linear was tried at one degree alone
        best = [min(c.tip_error_m for c in same if c.degree == degree) for degree in tried]
        axes.semilogy(tried, 1e3 * np.array(best), "o-", ms=4, label=f"images weigh {weight:g}")
    axes.set(xlabel="degree of W", ylabel="tip rms, weighed by trust [mm]", title="energy: cross-validation")
    axes.set_xticks(degrees)
    axes.legend(fontsize=8)
    return figure


def draw_convergence(choices: list[Choice], points: list[Point]) -> Figure:
    """Return the tip error over the degree of the energy, and over the number of equilibria."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    degrees = sorted({choice.degree for choice in choices})
    best = [min(c.tip_error_m for c in choices if c.degree == degree) for degree in degrees]
    left.semilogy(degrees, 1e3 * np.array(best), "ko-", ms=4)
    left.set(xlabel="degree of W", ylabel="tip rms, weighed by trust [mm]", title="equilibria, cross-validation", xticks=degrees)
    counts = [point.equilibria for point in points]
    right.semilogy(counts, [1e3 * point.static_m for point in points], "ko-", ms=4, label="held-out equilibria")
    if np.isfinite([point.dynamic_m for point in points]).all():
        right.semilogy(counts, [1e3 * point.dynamic_m for point in points], "rs-", ms=4, label="unseen trajectories")
    right.set(xlabel="equilibria in the fit", ylabel="tip rms [mm]", title="number of snapshots")
    right.legend(fontsize=8)
    return figure


def draw_parity(static: Prediction, baseline: Prediction) -> Figure:
    """Return held-out static tips: model and linearised model against the full model."""
    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    axes = figure.subplots(1, 3)
    for k, (axis, name) in enumerate(zip(axes, "xyz", strict=True)):
        full = 1e3 * static.full[:, k - 3]
        span = [full.min(), full.max()]
        axis.plot(span, span, "k-", lw=0.6)
        axis.plot(full, 1e3 * baseline.predicted[:, k - 3], ".", color="0.65", label="linearised")
        axis.plot(full, 1e3 * static.predicted[:, k - 3], "r+", label="reduced model")
        axis.set(xlabel=f"full model {name} [mm]", title=f"tip {name}, held-out equilibria")
    axes[0].set_ylabel("predicted [mm]")
    axes[0].legend(fontsize=8)
    return figure


def draw_motion(time_s: np.ndarray, moving: Prediction, number: int) -> Figure:
    """Return one trajectory of the tip, full and reduced, and what is between them."""
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for k, colour in enumerate(("C0", "C1", "C2")):
        top.plot(time_s, 1e3 * moving.full[number, :, k - 3], color=colour, lw=1.8, alpha=0.45)
        top.plot(time_s, 1e3 * moving.predicted[number, :, k - 3], "--", color=colour, lw=1.0, label="xyz"[k])
    top.set(ylabel="tip [mm]", title=f"unseen trajectory {number + 1}: full model (solid), reduced (dashed)")
    top.legend(fontsize=8, ncols=3)
    bottom.plot(time_s, 1e3 * moving.tip_errors()[number], "k-", lw=0.9)
    bottom.set(xlabel="time [s]", ylabel="distance [mm]")
    bottom.set_ylim(bottom=0.0)
    return figure
