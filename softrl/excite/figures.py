"""Figures of a planned program."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from softrl.artifacts.excitation import Excitation


def draw_program(planned: Excitation) -> Figure:
    """Return the commands over time, one row a chamber, with the blocks marked."""
    chambers = planned.pressure.shape[1]
    figure = Figure(figsize=(11.0, 1.4 + 1.3 * chambers), layout="constrained")
    rows = figure.subplots(chambers, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for i, row in enumerate(rows):
        row.plot(planned.time, 1e-3 * planned.pressure[:, i], lw=0.9)
        row.set_ylabel(f"chamber {i + 1}\n(kPa)")
        for number, block in enumerate(planned.blocks):
            row.axvspan(block["start_s"], block["start_s"] + block["duration_s"], alpha=0.06 + 0.06 * (number % 2))
    for number, block in enumerate(planned.blocks):
        middle = block["start_s"] + 0.5 * block["duration_s"]
        rows[0].text(middle, 1.02, str(number + 1), ha="center", transform=rows[0].get_xaxis_transform())
    rows[-1].set_xlabel("time (s)")
    legend = "; ".join(f"{k + 1} {block['label']}" for k, block in enumerate(planned.blocks))
    figure.suptitle(_wrapped(legend, 130), fontsize="small")
    return figure


def draw_separations(pairs: list[dict[str, Any]]) -> Figure:
    """Return the separation of each pair under the planned program and the baselines."""
    figure = Figure(figsize=(8.0, 1.6 + 0.7 * len(pairs)), layout="constrained")
    axes = figure.subplots()
    names = list(pairs[0]["separation_sigma"])
    height = 0.8 / len(names)
    for k, name in enumerate(names):
        values = [pair["separation_sigma"][name] for pair in pairs]
        bars = axes.barh(np.arange(len(pairs)) + k * height, values, height, label=name)
        axes.bar_label(bars, fmt="%.3g", padding=3, fontsize="small")
    axes.set_yticks(np.arange(len(pairs)) + 0.4 - 0.5 * height)
    axes.set_yticklabels([f"{pair['first']}\nagainst {pair['second']}" for pair in pairs])
    axes.set(xlabel="separation after refitting (standard deviations of the noise)")
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.legend()
    return figure


def _wrapped(text: str, width: int) -> str:
    lines = [""]
    for part in text.split("; "):
        lines = [*lines, part] if len(lines[-1]) + len(part) > width else [*lines[:-1], f"{lines[-1]}{part};  "]
    return "\n".join(lines)
