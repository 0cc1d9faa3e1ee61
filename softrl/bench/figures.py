"""Pictures of what was measured."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from softrl.fem.convergence import Study


def draw_scaling(unknowns: Sequence[int], metrics: Sequence[dict[str, float]], found: Study | None = None) -> Figure:
    """Return time and memory of the full model against the number of unknowns; ``found`` adds equilibria."""
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    times, memory = figure.subplots(1, 2)
    for name, label in (("assembly", "assembly"), ("factor_solve", "factorisation and solution"), ("step", "time step")):
        low, middle, high = ([m[f"{name}{kind}_ms"] for m in metrics] for kind in ("_min", "", "_max"))
        spread = [[m - a for m, a in zip(middle, low, strict=True)], [b - m for m, b in zip(middle, high, strict=True)]]
        times.errorbar(unknowns, middle, yerr=spread, marker="o", capsize=3, label=label)
    if found is not None:
        times.plot(found.unknowns, 1e3 * found.seconds, "s--", label="equilibrium")
    times.set(xscale="log", yscale="log", xlabel="unknowns", ylabel="ms (median, shortest to longest)")
    times.legend(frameon=False, fontsize=8)
    memory.plot(np.array(unknowns) / 1e3, [m["peak_memory_gb"] for m in metrics], "o-")
    memory.set(xlabel="unknowns in thousands", ylabel="peak memory in GB", xlim=(0.0, None), ylim=(0.0, None))
    return figure


def draw_motions(time_s: np.ndarray, full: Sequence[np.ndarray], bodies: Mapping[str, Sequence[np.ndarray]]) -> Figure:
    """Return the tips (steps, 3) m of the full model and of reduced bodies over time, and how far these are from it."""
    figure = Figure(figsize=(9.0, 2.4 * len(full)), layout="constrained")
    rows = figure.subplots(len(full), 2, squeeze=False, sharex=True)
    for k, (path, distance) in enumerate(rows):
        for axis, name in enumerate("xyz"):
            moved = 1e3 * (full[k][:, axis] - full[k][0, axis])
            path.plot(time_s, moved, color=f"C{axis}", lw=2.5, alpha=0.4, label=f"{name}, full")
            for style, tips in zip(("-", "--"), bodies.values(), strict=False):
                path.plot(time_s, 1e3 * (tips[k][:, axis] - full[k][0, axis]), style, color=f"C{axis}", lw=1)
        for name, tips in bodies.items():
            distance.plot(time_s, 1e3 * np.linalg.norm(tips[k] - full[k], axis=1), label=name)
        path.set(ylabel="tip from start, mm")
        distance.set(ylabel="apart in mm", ylim=(0.0, None))
    rows[0, 0].legend(frameon=False, fontsize=7)
    rows[0, 1].legend(frameon=False, fontsize=8)
    for axis in rows[-1]:
        axis.set_xlabel("time in s")
    return figure
