"""The table of results at the end of a command."""

from collections.abc import Sequence
from typing import Any

HIDDEN = ("train/", "loss/")


def table(finished: Sequence[Any]) -> str:
    """Return one line a number: stage, metric, value, in the order in which stages ran."""
    lines = ["", f"{'stage':<12} {'result':<44} {'value':>12}"]
    for outcome in finished:
        shown = {k: v for k, v in outcome.metrics.items() if not k.startswith(HIDDEN)}
        lines += [f"{outcome.stage:<12} {name:<44} {value:>12.5g}" for name, value in shown.items()]
        word = "reused" if outcome.reused else "seconds_s"
        lines.append(f"{outcome.stage:<12} {word:<44} {outcome.seconds:>12.1f}")
    last = finished[-1]
    report = last.folder / "report.html"
    if report.is_file():
        lines.append(f"report: {report}")
    lines.append("browse every run: make ui")
    return "\n".join(lines)
