"""One page that opens without a network: the verdict first, then figures and tables."""

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from softrl.artifacts.diagnosis import Diagnosis

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.4rem } h2 { font-size: 1.1rem; margin-top: 2rem } .verdict { font-size: 1.2rem; font-weight: 600 }
table { border-collapse: collapse; font-size: .85rem }
td, th { border: 1px solid #ccc; padding: .2rem .6rem; text-align: left }
img { max-width: 100% } .quiet { color: #666; font-size: .85rem }
"""
CAPTIONS = {
    "held_out_run": "Measured and predicted motion on a run that no fit saw, and the errors",
    "residual_map": "Where the error sits: over time and pressure, and over the pressures",
    "pipeline": "Where along the way from command to sensor",
    "whiteness": "Whether what is left has a memory, before and after",
    "errors": "Errors of the competitors",
    "rivals": "Alternatives to what is named, on held-out runs",
    "intervals": "Identified parameters with their intervals",
    "located": "Where simulation and measurement part, before any effect is added",
    "screening": "What each effect of the library explains when it is added first",
}


def page(diagnosis: Diagnosis, figures: Mapping[str, Figure]) -> str:
    """Return the report as HTML with its figures inside."""
    first, *rest = diagnosis.sentences
    body = [
        f"<h1>Diagnosis of {_safe(diagnosis.robot_name)} against {_safe(diagnosis.simulator_name)}</h1>",
        f"<p class='verdict'>{_safe(first)}</p>",
        *(f"<p>{_safe(line)}</p>" for line in rest),
    ]
    body += [f"<p><b>Record next:</b> {line}</p>" for line in _next(diagnosis)]
    body += [_figure(name, figure) for name, figure in figures.items()]
    body += [f"<h2>Identified parameters{_level(diagnosis)}</h2>", _table(_parameter_rows(diagnosis))]
    body += ["<h2>Retuned only</h2>", _table([{"parameter": k, **v} for k, v in diagnosis.retuned.items()])]
    body += ["<h2>Tests of where</h2>", _table(diagnosis.located)]
    body += [f"<p class='quiet'>{_safe(line)}</p>" for line in diagnosis.data["warnings"]]
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{_safe(diagnosis.verdict)}: "
        f"{_safe(diagnosis.robot_name)}</title><style>{STYLE}</style></head><body>{''.join(body)}</body></html>"
    )


def _next(diagnosis: Diagnosis) -> list[str]:
    """Return as HTML what to record next, if anything is open; ``stage=excite`` plans only for hypotheses that contest."""
    wanted = diagnosis.next_experiment
    if not wanted:
        return []
    lasts = [f"{wanted['duration_s']:.0f} s"] if "duration_s" in wanted else []
    planned = ["<code>stage=excite</code> writes a program"] if any(row["contests"] for row in diagnosis.rivals) else []
    told = "; ".join([*lasts, *planned])
    return [f"{_safe(wanted['program'])}{f' ({told})' if told else ''}."]


def _level(diagnosis: Diagnosis) -> str:
    """Return in words of which level the intervals are; data that cannot tell have none."""
    return f" and their {diagnosis.data['interval_pct']:g} % intervals" if "interval_pct" in diagnosis.data else ""


def _figure(name: str, figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f"<h2>{_safe(CAPTIONS.get(name, name))}</h2><img alt='{_safe(name)}' src='data:image/png;base64,{data}'>"


def _parameter_rows(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    rows = [
        {"effect": effect["name"], "where": effect["where"], "parameter": name, **entry}
        for effect in diagnosis.effects
        for name, entry in effect["parameters"].items()
    ]
    rows += [
        {"effect": effect["name"], "where": effect["where"], "parameter": f"{name}, held",
         "value": effect["pinned"][name], **entry}
        for effect in diagnosis.effects
        for name, entry in effect.get("pinned_intervals", {}).items()
    ]  # fmt: skip
    rows += [
        {"effect": "simulator", "where": "body", "parameter": name, "value": value, "low": "", "high": "", "unit": ""}
        for name, value in diagnosis.simulator_parameters.items()
    ]
    return rows


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return "<p class='quiet'>none</p>"
    head = "".join(f"<th>{_safe(key)}</th>" for key in rows[0])
    lines = ("".join(f"<td>{_safe(_short(value))}</td>" for value in row.values()) for row in rows)
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def _short(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _safe(text: str) -> str:
    return html.escape(str(text))
