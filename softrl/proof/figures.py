"""Three pictures of a proof: what was called what, what is seen at which loudness, and errors by stratum."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from softrl.proof.generator.plan import STRATA
from softrl.proof.score import SILENT, Row, wilson

MODELS = ("oracle", "corrected", "retuned", "blackbox", "nominal")


def confusion(rows: Sequence[Row]) -> Figure:
    """Return what was hidden against what was named first; a frame marks the right answers."""
    shown = [r for r in rows if r["stratum"] in ("null", "nuisance", "single", "concealed", "outside")]
    told = [_told(r) for r in shown]
    truths = list(dict.fromkeys(sorted(_hidden(r) for r in shown)))
    names = list(dict.fromkeys(sorted(told)))
    count, right = np.zeros((2, len(truths), len(names)), dtype=int)
    for r, name in zip(shown, told, strict=True):
        i, j = truths.index(_hidden(r)), names.index(name)
        count[i, j] += 1
        right[i, j] += _is_right(r)
    figure = Figure(figsize=(3.5 + 0.45 * len(names), 2.0 + 0.3 * len(truths)), layout="constrained")
    ax = figure.subplots()
    ax.imshow(count, cmap="Blues", vmin=0.0, vmax=max(count.max(), 1.0), aspect="auto")
    for i, j in zip(*np.nonzero(count), strict=True):
        ax.text(
            j,
            i,
            f"{count[i, j]}" if right[i, j] in (0, count[i, j]) else f"{right[i, j]} of {count[i, j]}",
            ha="center",
            va="center",
            color="white" if count[i, j] > 0.6 * count.max() else "k",
        )
    for i, j in zip(*np.nonzero(right), strict=True):
        ax.add_patch(_frame(i, j))
    ax.set_xticks(range(len(names)), names, rotation=60, ha="right")
    ax.set_yticks(range(len(truths)), truths)
    ax.set_xlabel("verdict, or the effect named first")
    ax.set_ylabel("hidden")
    ax.set_title("green frame: right, or as many of them as it says", loc="left", fontsize=9)
    return figure


def detection(rows: Sequence[Row], detectable: float) -> Figure:
    """Return the share of single effects found, and named rightly, against their loudness."""
    singles = [r for r in rows if r["stratum"] == "single"]
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    ax = figure.subplots()
    edges = np.array([0.0, 0.7, 3.0, 9.0, np.inf])
    kinds: tuple[tuple[Callable[[Row], bool], str, str, float], ...] = (
        (lambda r: r["verdict"] not in SILENT, "something found", "0.6", 0.97),
        (lambda r: bool(r["top1"]), "named first and right", "C0", 1.03),
    )
    for holds, label, colour, aside in kinds:
        labels = iter((label,))  # of the first point alone
        for k in range(len(edges) - 1):
            mine = [r for r in singles if edges[k] <= r["signal_to_noise"] < edges[k + 1]]
            if mine:
                share = wilson(sum(map(holds, mine)), len(mine))
                x = aside * float(np.exp(np.mean(np.log([max(r["signal_to_noise"], 0.05) for r in mine]))))
                ax.errorbar(x, share.pct, [[share.pct - share.low], [share.high - share.pct]], fmt="o", color=colour,
                            capsize=3, label=next(labels, None))  # fmt: skip
                if aside > 1.0:
                    ax.annotate(f"n = {len(mine)}", (x * 1.1, 50.0), fontsize=8)
    ax.axvline(detectable, color="k", lw=0.8, ls=":", label="called detectable")
    ax.set_xscale("log")
    ax.set_xlim(0.05, 60.0)
    ax.set_ylim(-3.0, 103.0)
    ax.set_xlabel("rms of the hidden effect after retuning over the noise floor")
    ax.set_ylabel("cases, % (95 % Wilson)")
    ax.legend(frameon=False, loc="upper left", fontsize=8)
    return figure


def errors(rows: Sequence[Row]) -> Figure:
    """Return the errors of all competitors out of distribution, by stratum."""
    figure = Figure(figsize=(7.5, 4.0), layout="constrained")
    ax = figure.subplots()
    for k, model in enumerate(MODELS):
        for i, stratum in enumerate(STRATA):
            mine = [r[f"outside_{model}_mm"] for r in rows if r["stratum"] == stratum and f"outside_{model}_mm" in r]
            if mine:
                x = i + 0.16 * (k - 2)
                ax.plot(np.full(len(mine), x), mine, "o", ms=3, color=f"C{k}", alpha=0.4)
                ax.plot(
                    [x - 0.06, x + 0.06],
                    [np.median(mine)] * 2,
                    "-",
                    lw=2.5,
                    color=f"C{k}",
                    label=model if i == 0 else None,
                )
    ax.set_yscale("log")
    ax.set_xticks(range(len(STRATA)), STRATA)
    ax.set_ylabel("rms tip error out of distribution, mm")
    ax.legend(frameon=False, ncol=len(MODELS), loc="upper center", bbox_to_anchor=(0.5, 1.12))
    return figure


def _hidden(row: Row) -> str:
    if row["stratum"] in ("null", "nuisance"):
        return str(row["stratum"])
    faint = "" if row["detectable"] else " (too faint)"  # of which no answer is asked
    return ("~ " if row["stratum"] == "outside" else "") + str(row["truth"]) + faint


def _told(row: Row) -> str:
    told = row["named"] and row["verdict"] in ("named", "indistinguishable")
    return str(row["named"].split("+")[0] if told else f"[{row['verdict']}]")


def _is_right(row: Row) -> bool:
    if row["stratum"] in ("null", "nuisance"):
        return not row["found_something"]
    return bool(row["verdict"] == "unknown" if row["stratum"] == "outside" else row["top1"])


def _frame(i: int, j: int) -> Rectangle:
    return Rectangle((j - 0.48, i - 0.48), 0.96, 0.96, fill=False, ec="C2", lw=1.8)
