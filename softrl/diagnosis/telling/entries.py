"""Findings in plain values, as in ``diagnosis.json``: effects, rivals, retuned parameters, what is left."""

from collections.abc import Sequence
from math import degrees
from typing import Any

from softrl.diagnosis.fitting.hypothesis import (
    GATES,
    LASTING,
    LATE,
    Choice,
    effect_axes,
    has_chamber,
    pinned_values,
)
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import columns_of
from softrl.diagnosis.judging.correct import Model
from softrl.diagnosis.judging.examine import Finding, Named, Part
from softrl.diagnosis.judging.rivals import Rival
from softrl.effects.library import effect_class
from softrl.robots.robot import Robot

COUNTED = {"session": "counts from the session's first run", "ever": "counts from the first run of all"}


def effect_entries(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return one entry a named effect, as in ``diagnosis.json``: what explains most first, part by part, maps last."""
    found = [(finding, named) for finding in findings for named in sorted(finding.named, key=lambda n: -n.gap.value)]
    return [_entry(*pair) for pair in sorted(found, key=lambda pair: effect_class(pair[1].choice.name).together)]


def _entry(finding: Finding, named: Named) -> dict[str, Any]:
    choice = named.choice
    factor, unit = shown_in(finding)
    without = factor * float(finding.judge.excess(finding.final.mean_square)) + factor * named.gap.value
    told = {"name": choice.name, "title": effect_class(choice.name).title, "site": choice.site, "where": where(choice)}
    parameters = {
        p.name: {"value": p.value, "low": p.low, "high": p.high, "unit": p.unit, "at_bound": p.at_bound}
        for p in named.intervals
    }
    told_of_pinned = {p.name: {"low": p.low, "high": p.high, "unit": p.unit} for p in named.pinned}
    evidence = (
        f"{finding.part.title}: without it the held-out error above the noise is {without:.3g} {unit}, with it "
        f"{without - factor * named.gap.value:.3g} {unit} (gain {factor * named.gap.low:.3g} to "
        f"{factor * named.gap.high:.3g} {unit})"
    )
    return told | _form(finding.part, choice) | {
        "parameters": parameters, "pinned_intervals": told_of_pinned, "evidence": evidence
    }  # fmt: skip


def where(choice: Choice) -> str:
    """Return in words where an effect acts; what acts everywhere on the body or in all chambers, but not always, says when."""
    told = [] if choice.sessions and choice.chamber < 0 else [_place(choice)]
    told += [GATES[choice.gate.field]] if choice.gate else []
    told += [f"{LASTING[choice.lasting]} (its time {COUNTED[choice.lasting]})"] if choice.lasting else []
    told += [f"{choice.period} only"] if choice.sessions else []
    told += [choice.gauge] if choice.gauge else []
    return ", ".join(told)


def _place(choice: Choice) -> str:
    if has_chamber(choice.name):
        return "all chambers" if choice.chamber < 0 else f"chamber {choice.chamber + 1}"
    places = {"valve": "all valves", "load": "tip", "sensor": "pose sensor", "chamber": "all chambers"}
    return "one layer" if effect_class(choice.name).layered else places.get(choice.site, "whole body")


def shown_in(finding: Finding) -> tuple[float, str]:
    """Return factor and unit in which a part's errors are shown."""
    problem = finding.part.problem
    if problem.target == "pressure":
        return 1e-3, "kPa"
    if problem.robot.output == "bend_angle":
        return degrees(1.0) / problem.robot.length_m, "deg"
    return 1e3, "mm"


def command_in(robot: Robot) -> tuple[float, str]:
    """Return factor and unit in which commands (stored in Pa) are shown: of one that is no pressure, its own."""
    return (1e-3, "kPa") if robot.command == "pressure" else (1.0 / robot.command_to_pa, robot.command)


def rival_entries(findings: Sequence[Finding], robot: Robot) -> list[dict[str, Any]]:
    """Return the alternatives, those that contest first, then nearest; gaps of motion in mm or deg, of measured pressure in kPa.

    Near is a gap that is small beside what counts in its part of the pipeline: kPa and mm have no order of their own.
    ``effect`` is the alternative as it was fitted and ``replaces`` what is named, for programs that build either: by their
    labels alone people tell them.
    """
    ranked: list[tuple[tuple[bool, float], dict[str, Any]]] = []
    for finding in findings:
        factor, unit = shown_in(finding)
        rows = [
            {
                "name": rival.choice.label(),
                "instead_of": rival.instead_of.label(),
                "score_gap": factor * rival.gap.value,
                "low": factor * rival.gap.low,
                "high": factor * rival.gap.high,
                "unit": unit,
                "equivalent": rival.equivalent,
                "contests": rival.contests,
                "effect": _form(finding.part, rival.choice) | {"parameters": _fitted(finding.part.problem, rival)},
                "replaces": _form(finding.part, rival.instead_of),
            }
            for rival in finding.rivals
        ]
        places = [(not rival.contests, rival.gap.value / max(finding.judge.material, 1e-300)) for rival in finding.rivals]
        ranked += zip(places, rows, strict=True)
    return [row for _, row in sorted(ranked, key=lambda pair: pair[0])]


def _form(part: Part, choice: Choice) -> dict[str, Any]:
    """Return where and when ``choice`` acts, what is pinned, and its clock; a gate's number is one of its parameters."""
    flags = {name: True for name in ("before_gauge", "behind_gauge") if getattr(choice, name)}
    return {
        "name": choice.name,
        "chamber": choice.chamber,
        "sessions": list(choice.sessions),
        "past": bool(choice.sessions) and part.now.session not in choice.sessions,
        "lasting": choice.lasting,
        "pinned": pinned_values(choice) | flags | ({"begun_s": part.now.gone_s[-1]} if choice.lasting == "ever" else {}),
    }


def _fitted(problem: Problem, rival: Rival) -> dict[str, float]:
    """Return the free parameters of an alternative as they were fitted, the gate's too."""
    values = problem.space(rival.trial.hypothesis).values(rival.trial.fit.point)
    names = [axis.name for axis in effect_axes(rival.choice)]
    return {name: values[k] for name, k in zip(names, columns_of(rival.trial, rival.choice), strict=True)}


def retuned_entries(whole: Problem, model: Model) -> dict[str, Any]:
    """Return the parameters of the retuned-only competitor, and whether each is plausible: no data drive it to an end."""
    space, ends = whole.space(model.hypothesis), model.ends
    return {
        axis.name: {
            "nominal": axis.zero, "value": value, "lowest": axis.low, "highest": axis.high, "plausible": axis.name not in ends
        }
        for axis, value in zip(space.axes, space.values(model.point), strict=True)
        if axis.name != LATE
    }


def unexplained(findings: Sequence[Finding]) -> dict[str, Any]:
    """Return what is left of each part's held-out error after the correction."""
    left: dict[str, Any] = {}
    for finding in findings:
        factor, unit = shown_in(finding)
        left[finding.part.title] = {
            f"rms_above_noise_{unit.lower()}": factor * finding.left,
            "explained_share": finding.explained,
            "unknown": finding.unknown,
            "because": "; ".join(finding.reasons),
            "offered": {
                "kind": "ridge regression of the residual on pressures and their past: no physics, valid where trained",
                f"removes_{unit.lower()}": factor * finding.offer.gap.value,
                "low": factor * finding.offer.gap.low,
                "high": factor * finding.offer.gap.high,
                "pays": finding.offer.pays,
            },
            "closest": finding.closest,
            "retuned_rms_mixed": factor * finding.judge.rms(finding.base.squares),
            "corrected_rms_mixed": factor * finding.judge.rms(finding.final.squares),
        }
    return left
