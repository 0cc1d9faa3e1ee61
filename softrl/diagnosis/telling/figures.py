"""Figures of a diagnosis."""

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import NullFormatter

from softrl.artifacts.diagnosis import Diagnosis
from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging.correct import Traces, off, seen
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.series.noise import directions
from softrl.diagnosis.telling.entries import command_in, shown_in
from softrl.effects.effect import SITES

COLOURS = {"measured": "black", "nominal": "tab:gray", "retuned": "tab:blue", "corrected": "tab:red",
           "one_lag": "tab:purple", "static": "tab:olive", "blackbox": "tab:green"}  # fmt: skip
STATION_WIDTH, LINE = 25, 0.095  # letters below a station of the pipeline, and height of a line of them, data units
IN_WORDS = {"blackbox": "black box", "heldout": "held out"}


def draw_all(
    diagnosis: Diagnosis, heldout: Problem, findings: Sequence[Finding], judged: dict[str, Traces]
) -> dict[str, Figure]:
    """Return the figures by name."""
    figures = {"pipeline": draw_pipeline(diagnosis, findings), "held_out_run": draw_run(heldout, judged)}
    figures["errors"] = draw_errors(diagnosis)
    figures["residual_map"] = draw_map(heldout, judged)
    figures["whiteness"] = draw_whiteness(findings)
    if diagnosis.rivals:
        figures["rivals"] = draw_rivals(diagnosis)
    if diagnosis.effects:
        figures["intervals"] = draw_intervals(diagnosis)
    figures["located"] = draw_located(diagnosis)
    figures["screening"] = draw_screening(findings)
    return figures


def draw_run(heldout: Problem, judged: dict[str, Traces]) -> Figure:
    """Draw measured against predicted motion of the held-out run that moves most, and the errors below."""
    k = int(np.argmax([np.ptp(seen(heldout, run), axis=0).max() for run in heldout.runs]))
    run, angle = heldout.runs[k], heldout.robot.output == "bend_angle"
    measured = seen(heldout, run)
    main = int(np.argmax(np.ptp(measured, axis=0)))
    factor, unit = (180.0 / np.pi, "deg") if angle else (1e3, "mm")
    figure = Figure(figsize=(9, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(run.time, np.where(run.seen, factor * measured[:, main], np.nan), color="black", lw=1.6, label="measured")
    for name in ("nominal", "retuned", "corrected"):
        traces = judged[name]
        above.plot(run.time, factor * traces.predicted[k][:, main], color=COLOURS[name], lw=0.9, label=name)
        error = factor * off(heldout, k, traces.predicted[k])
        label = f"{name}: rms {np.sqrt(np.nanmean(error**2)):.3g} {unit}"
        below.plot(run.time[heldout.first[k] :], error, color=COLOURS[name], lw=0.9, label=label)
    above.set_ylabel(f"{'bend angle' if angle else 'tip ' + 'xyz'[main]}, {unit}")
    above.set_title(f"held-out run {run.name}", loc="right", fontsize=9)
    below.set_ylabel(f"error, {unit}")
    below.set_xlabel("time, s")
    for ax in (above, below):  # above the frame, where it hides no peak
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=8, ncols=4, frameon=False, borderaxespad=0.2)
    return figure


def draw_map(heldout: Problem, judged: dict[str, Traces]) -> Figure:
    """Draw the held-out error before and after, over time and pressure, and over two pressures (or pressure and rate)."""
    rows = list(zip(heldout.runs, heldout.first, strict=True))
    scale, of_command = command_in(heldout.robot)
    command = np.concatenate([scale * run.pressure_cmd[begin:] for run, begin in rows])
    moved: np.ndarray = np.max([np.ptp(run.pressure_cmd, axis=0) for run in heldout.runs], axis=0)
    order = np.argsort(-moved)  # within runs: a chamber that is held at another level on another day is not driven
    first = order[0]
    if len(order) > 1 and moved[order[1]] > 0.0:
        second, other = command[:, order[1]], f"command of chamber {order[1] + 1}, {of_command}"
    else:
        second = np.concatenate([np.gradient(scale * run.pressure_cmd[:, first], run.time)[begin:] for run, begin in rows])
        reach = np.quantile(np.abs(second), 0.98) or 1.0
        second, other = np.clip(second, -reach, reach), f"rate of the command, {of_command}/s"
    time = np.concatenate([(run.time - run.time[0])[begin:] for run, begin in rows])
    factor, unit = (180.0 / np.pi, "deg") if heldout.robot.output == "bend_angle" else (1e3, "mm")
    errors = {
        name: factor * np.concatenate([off(heldout, k, predicted) for k, predicted in enumerate(judged[name].predicted)])
        for name in ("retuned", "corrected")
    }
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots(2, 2)
    maps = [[_mean_over(x, command[:, first], errors[name]) for name in errors] for x in (time, second)]
    top = max(float(np.nanmax(values)) for row in maps for values, *_ in row)
    for row, label in zip(range(2), ("time in run, s", other), strict=True):
        for ax, (values, x, y), name in zip(axes[row], maps[row], errors, strict=True):
            image = ax.pcolormesh(x, y, values.T, vmin=0.0, vmax=top, cmap="magma_r")
            ax.set_title(f"{name}, held-out runs", fontsize=9)
            ax.set_xlabel(label)
        axes[row][0].set_ylabel(f"command of chamber {first + 1}, {of_command}")
    figure.colorbar(image, ax=axes, label=f"mean error, {unit}")
    return figure


def _mean_over(x: np.ndarray, y: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean error (24, 12) over two coordinates, and the edges of its cells."""
    x_edges, y_edges = np.histogram2d(x, y, bins=(24, 12))[1:]
    x, y, error = (values[np.isfinite(error)] for values in (x, y, error))  # else the motion was lost
    count = np.histogram2d(x, y, bins=(x_edges, y_edges))[0]
    total = np.histogram2d(x, y, bins=(x_edges, y_edges), weights=error)[0]
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0), x_edges, y_edges


def draw_pipeline(diagnosis: Diagnosis, findings: Sequence[Finding]) -> Figure:
    """Draw the way from command to sensor, with the effects that are named and the part that stays unexplained."""
    stations = ["command", *SITES]
    named: dict[str, list[str]] = {station: [] for station in stations}
    for e in diagnosis.effects:
        named[e["site"]] += [e["name"], *textwrap.wrap(f"({e['where']})", STATION_WIDTH)]
    below = max(0.55, 0.08 + LINE * max(map(len, named.values())))
    figure = Figure(figsize=(9, 1.5 * (1.05 + below)), layout="constrained")
    ax = figure.subplots()
    for k, (station, mine) in enumerate(named.items()):
        colour = "#f6b0a8" if mine else "#e8e8e8"
        ax.add_patch(Rectangle((k, 0.0), 0.8, 0.5, facecolor=colour, edgecolor="black"))
        ax.text(k + 0.4, 0.25, station, ha="center", va="center")
        ax.text(k + 0.4, -0.08, "\n".join(mine), ha="center", va="top", fontsize=8, color="tab:red")
        if k:
            ax.annotate("", (k, 0.25), (k - 0.2, 0.25), arrowprops={"arrowstyle": "->"})
    split = len(findings) > 1
    ends = [(1, 1), (2, len(stations) - 1)] if split else [(1, len(stations) - 1)]
    for finding, (first, last) in zip(findings, ends, strict=True):
        factor, unit = shown_in(finding)
        words = f"{finding.part.title}: {factor * finding.left:.3g} {unit} left" + (
            ", unexplained" if finding.unknown else ""
        )
        colour = "tab:orange" if finding.unknown else "tab:green"
        ax.plot([first, last + 0.8], [0.62, 0.62], color=colour, lw=3)
        ax.text(first if first == 1 else last + 0.8, 0.68 if first > 1 else 0.84, words, color=colour, fontsize=8,
                ha="left" if first == 1 else "right", va="bottom")  # fmt: skip
    ax.set_xlim(-0.1, len(stations))
    ax.set_ylim(-below, 1.05)
    ax.set_axis_off()
    return figure


def draw_whiteness(findings: Sequence[Finding]) -> Figure:
    """Draw the autocorrelation of what is left on held-out runs, before and after the correction."""
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    for ax, finding in zip(figure.subplots(1, len(findings), squeeze=False)[0], findings, strict=True):
        problem = finding.judge.problem
        for name, residual, colour in (
            ("retuned", finding.residual_before, COLOURS["retuned"]),
            ("corrected", finding.residual_after, COLOURS["corrected"]),
        ):
            lags = min(60, min(len(run) for run in residual.runs) // 2)
            ax.plot(problem.spacing_s * np.arange(lags), _autocorrelation(residual.runs, lags), color=colour, label=name)
        band = _white_band(finding.residual_after.runs)
        ax.axhspan(-band, band, color="0.85", label="white noise, 95 %")
        ax.set_xlabel("lag, s")
        ax.set_title(finding.part.title, fontsize=9)
        ax.legend(loc="upper right", fontsize=8)
    figure.axes[0].set_ylabel("autocorrelation of what is left")
    return figure


def _autocorrelation(runs: Sequence[np.ndarray], lags: int) -> np.ndarray:
    centred = [run - run.mean(axis=0) for run in runs]
    power = max(sum(float(np.sum(run**2)) for run in centred), 1e-300)
    return np.array([sum(float(np.sum(run[k:] * run[: len(run) - k])) for run in centred) / power for k in range(lags)])


def _white_band(runs: Sequence[np.ndarray]) -> float:
    """Return how far from zero 95 % of the autocorrelations of white noise lie that is as large and alike in its channels.

    Of n independent channels that are equally large there are n times as many numbers as samples.
    """
    centred = np.concatenate([run - run.mean(axis=0) for run in runs])
    return float(1.96 / np.sqrt(directions(centred) * len(centred)))


def draw_errors(diagnosis: Diagnosis) -> Figure:
    """Draw training and held-out errors of all competitors."""
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    ax = figure.subplots()
    shown = diagnosis.errors_deg or diagnosis.errors_mm
    width = 0.8 / max(len(shown), 1)
    for k, (split, errors) in enumerate(shown.items()):
        bars = ax.bar(np.arange(len(errors)) + (k + 0.5) * width - 0.4, list(errors.values()), width, label=_words(split))
        ax.bar_label(bars, fmt="%.2g", fontsize=7)
    ax.set_yscale("log")  # what is corrected would be a line at the bottom
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())  # the bars say their values
    ax.set_xticks(np.arange(len(errors)), [_words(name) for name in errors])
    ax.set_ylabel(f"rms error, {'deg' if diagnosis.errors_deg else 'mm'}")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8)
    return figure


def _words(name: str) -> str:
    return IN_WORDS.get(name, name.replace("_", " "))


def draw_rivals(diagnosis: Diagnosis) -> Figure:
    """Draw how much worse each alternative is on held-out runs, with intervals; one axis a unit."""
    units = list(dict.fromkeys(row["unit"] for row in diagnosis.rivals))
    rows = {unit: [row for row in diagnosis.rivals if row["unit"] == unit] for unit in units}
    figure = Figure(figsize=(8, 1.2 + 0.35 * len(diagnosis.rivals)), layout="constrained")
    axes = figure.subplots(len(units), 1, squeeze=False, height_ratios=[len(rows[u]) + 0.5 for u in units])[:, 0]
    for ax, unit in zip(axes, units, strict=True):
        for k, row in enumerate(rows[unit]):
            colour = "tab:orange" if row["equivalent"] else "tab:blue"
            ax.plot([row["low"], row["high"]], [k, k], color=colour, lw=2)
            ax.plot(row["score_gap"], k, "o", color=colour)
        labels = [f"{row['name']} for {row['instead_of']}" for row in rows[unit]]
        ax.ticklabel_format(axis="x", scilimits=(-3, 4))
        ax.set_yticks(range(len(labels)), labels, fontsize=8)
        ax.set_ylim(len(labels) - 0.5, -0.5)
        ax.axvline(0.0, color="black", lw=0.8)
        ax.set_xlabel(f"held-out error beyond the named\neffects', {unit} (orange: alike)")
    return figure


def draw_intervals(diagnosis: Diagnosis) -> Figure:
    """Draw every parameter with its interval, one small axis each."""
    rows = [(e["name"], name, p) for e in diagnosis.effects for name, p in e["parameters"].items()]
    figure = Figure(figsize=(7, 0.75 * len(rows) + 0.4), layout="constrained")
    axes = figure.subplots(len(rows), 1, squeeze=False)[:, 0]
    for ax, (effect, name, p) in zip(axes, rows, strict=True):
        ax.plot([p["low"], p["high"]], [0, 0], color="tab:red", lw=3, alpha=0.5)
        ax.plot(p["value"], 0, "o", color="tab:red")
        ax.set_yticks([0], [f"{effect}.{name}, {p['unit']}"], fontsize=8)
        ax.tick_params(axis="x", labelsize=7)
        ax.ticklabel_format(axis="x", useOffset=False)  # an interval may be narrow beside its value
        ax.locator_params(axis="x", nbins=6)
    figure.supxlabel(f"bars: {diagnosis.data['interval_pct']:g} % intervals", fontsize=8)
    return figure


def draw_located(diagnosis: Diagnosis) -> Figure:
    """Draw the strongest significant tests of where the mismatch sits."""
    rows = [row for row in diagnosis.located if row["p_value"] < 0.01][:14] or diagnosis.located[:5]
    figure = Figure(figsize=(8, 0.8 + 0.3 * len(rows)), layout="constrained")
    ax = figure.subplots()
    labels = []
    for k, row in enumerate(rows):
        ax.barh(k, row["effect_size"], color="tab:red" if row["p_value"] < 0.01 else "tab:gray")
        chamber = f"chamber {row['chamber']}" if row["chamber"] else None
        labels.append(", ".join(part for part in (row["site"], row["channel"], chamber, row["region"]) if part))
        chance = f" p {row['p_value']:.1g}" if row["p_value"] > 1e-16 else " p < 1e-16"
        ax.annotate(chance, (row["effect_size"], k), fontsize=7, va="center")
    ax.set_yticks(range(len(labels)), labels, fontsize=8)
    ax.invert_yaxis()
    ax.set_xlim(0.0, 1.25)  # room for what stands beside the longest bar
    ax.set_xlabel("effect size before effects\n(share of power or correlation)")
    return figure


def draw_screening(findings: Sequence[Finding]) -> Figure:
    """Draw what each effect could save of the residual, as screened in the first round of each part."""
    figure = Figure(figsize=(5.0 * len(findings), 5), layout="constrained")
    axes = figure.subplots(1, len(findings), squeeze=False)[0]
    for ax, finding in zip(axes, findings, strict=True):
        leads = (finding.path.screened[0] if finding.path.screened else [])[:18]
        named = {label for effect in finding.named for label in _screened_as(effect.choice, [lead.choice for lead in leads])}
        colours = ["tab:red" if lead.choice.label() in named else "tab:gray" for lead in leads]
        ax.barh(range(len(leads)), [max(lead.gain, 0.0) for lead in leads], color=colours)
        ax.set_yticks(range(len(leads)), [lead.choice.label() for lead in leads], fontsize=8)
        ax.invert_yaxis()
        factor, unit = shown_in(finding)
        before = factor * finding.judge.rms(finding.base.squares)
        ax.set_title(f"{finding.part.title}\n(retuned rms {before:.3g} {unit})", fontsize=9)
        if not leads:
            ax.set_axis_off()
            told = "no effect was tried:\nretuning leaves less than counts"
            ax.text(0.5, 0.5, told, ha="center", va="center", fontsize=9, transform=ax.transAxes)
            continue
        ax.set_xlim(left=0.0)
    figure.supxlabel("share of the squared error on runs left out that it saves, fitted roughly", fontsize=9)
    return figure


def _screened_as(named: Choice, choices: Sequence[Choice]) -> list[str]:
    """Return the labels of those of the ``choices`` that became what is ``named``, which was slimmed since, or given a gate."""
    mine = [choice.label() for choice in choices if choice.label() == named.label()]
    return mine or [choice.label() for choice in choices if _plain(choice) == _plain(named)]


def _plain(choice: Choice) -> Choice:
    return choice._replace(pinned=(), gate=None, lasting="")
