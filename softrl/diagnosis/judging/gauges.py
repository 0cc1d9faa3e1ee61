"""A gauge that misreads by a factor: the valve seems to give it to the pressure, and the body behind to take it back."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, effect_axes
from softrl.diagnosis.fitting.intervals import by_effect, intervals
from softrl.diagnosis.fitting.trial import Search, Trial, axes_of, fit_trials
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.judging.leftover import heldout_residual

log = logging.getLogger(__name__)
SPAN, GAUGE = "gain", "pressure_sensor"
STIFFNESS = ("bending_stiffness_scale", "axial_stiffness_scale", "youngs_modulus_scale")

Behind = Callable[[Finding], Finding]


def with_misread_pressures(findings: list[Finding], behind: Behind, search: Search) -> list[Finding]:
    """Return the findings of valve and body, or those with gauges that misread where fewer effects then say as much.

    Asked where the valve gives a factor to a chamber's pressure, as its gauge shows, on which the body behind the gauge needs an
    effect, too, or is not understood. ``behind`` examines the body behind the pressures that a finding of the valve has acting.
    """
    if len(findings) < 2 or findings[0].unknown:
        return findings
    valve, body = findings
    felt = [named.choice.chamber for named in body.named]
    doubted = [named.choice for named in valve.named if _is_span(named.choice)]
    doubted = [choice for choice in doubted if body.unknown or (choice.chamber >= 0 and choice.chamber in felt)]
    misread = _misreading(valve, doubted, search) if doubted else None
    if misread is None:
        return findings
    log.info("the body is examined again behind gauges that may misread: %s", ", ".join(c.label() for c in doubted))
    again = behind(misread)
    fewer = len(again.named) < len(body.named) and again.unknown == body.unknown
    if not (fewer or (body.unknown and not again.unknown)) or body.judge.tells(again.final.squares, body.final.squares):
        return findings
    told = (
        f"{_named(misread)} takes the place of {', '.join(choice.label() for choice in doubted)}: "
        "what the gauge shows the body behind it does not feel."
    )
    log.info("%s", told)
    return [replace(misread, switched=(*misread.switched, told)), again]


def told_of_gauges(findings: Sequence[Finding], parameters: dict[str, float]) -> list[str]:
    """Return a sentence for a factor of all pressures that a valve is said to give, which may as well be that of the gauges."""
    stiff = {name: parameters[name] for name in STIFFNESS if name in parameters}
    found = []
    for named in findings[0].named if stiff else ():
        if _is_span(named.choice) and named.choice.chamber < 0 and not named.choice.gate and not named.choice.sessions:
            factor = named.intervals[0].value
            body = ", ".join(f"{name} {value / factor:.3g} for {value:.3g}" for name, value in stiff.items())
            found.append(
                f"Only gauges say that the pressures are {factor:.3g} times what was commanded. If they misread by that factor "
                f"(pressure_sensor), which no recording can tell from it, the body is as much softer: {body}."
            )
    return found


def _is_span(choice: Choice) -> bool:
    return choice.name == SPAN and choice.before_gauge and not (choice.gate and choice.gate.field == "above_share")


def _named(finding: Finding) -> str:
    return ", ".join(named.choice.label() for named in finding.named if named.choice.name == GAUGE)


def _misreading(valve: Finding, doubted: Sequence[Choice], search: Search) -> Finding | None:
    """Return the finding with gauges that misread in the place of the ``doubted`` factors, fitted again."""
    swapped = {choice: choice._replace(name=GAUGE, pinned=("offset",), before_gauge=False) for choice in doubted}
    final, problem, judge = valve.final, valve.part.problem, valve.judge
    effects = tuple(swapped.get(choice, choice) for choice in final.hypothesis.effects)
    task = Hypothesis(effects, final.hypothesis.tuned), [_point(final, swapped)]
    for trial in fit_trials(problem, judge.problem, [task], search):
        mine = by_effect(trial.hypothesis, intervals(problem, trial, judge.thresholds))
        choices = [swapped.get(named.choice, named.choice) for named in valve.named]
        named = [old._replace(choice=new, intervals=mine[new]) for old, new in zip(valve.named, choices, strict=True)]
        rivals = [r._replace(instead_of=swapped.get(r.instead_of, r.instead_of)) for r in valve.rivals]
        after = heldout_residual(judge, trial)
        return replace(valve, final=trial, named=named, rivals=rivals, residual_after=after)
    return None


def _point(final: Trial, swapped: dict[Choice, Choice]) -> np.ndarray:
    """Return the point of ``final`` with the factors of the gauges in the place of those of the pressures."""
    point = final.fit.point.copy()
    for old, new in swapped.items():
        axis, column = axes_of(final, old)["gain"]
        (own,) = (axis for axis in effect_axes(new) if axis.name == "gain")
        point[column] = own.scaled(axis.physical(point[column]))
    return point
