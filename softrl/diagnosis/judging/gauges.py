"""Gauges that misread by a factor, or slowly: the valve is then told with what is theirs, and the body behind takes it back."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, effect_axes
from softrl.diagnosis.fitting.intervals import by_effect, intervals
from softrl.diagnosis.fitting.trial import Search, Trial, axes_of, fit_trials
from softrl.diagnosis.judging.another_body import does_as_well
from softrl.diagnosis.judging.examine import Finding, switched
from softrl.diagnosis.judging.leftover import heldout_residual
from softrl.diagnosis.judging.parts import punctual

log = logging.getLogger(__name__)
SPAN, GAUGE, SLOW = "gain", "pressure_sensor", "gauge_lag"
STIFFNESS = ("bending_stiffness_scale", "axial_stiffness_scale", "youngs_modulus_scale")

Valve = Callable[[Sequence[Choice]], Finding]
Body = Callable[[Finding], Finding]


def behind_gauges(findings: list[Finding], valve: Valve, body: Body, search: Search) -> list[Finding]:
    """Return the findings of valve and body, or those with gauges that err where that says as much with fewer effects.

    ``valve`` examines the valve as gauges show it that may err so, and ``body`` the body behind a finding of the valve.
    """
    if len(findings) < 2 or findings[0].unknown:
        return findings
    return _behind_misreading(_behind_slow(findings, valve, body, search), body, search)


def _behind_slow(findings: list[Finding], valve: Valve, body: Body, search: Search) -> list[Finding]:
    """Return the findings with slow gauges, which the body alone tells: it is ahead of what they show."""
    former, last = findings
    told = [choice for choice in _of(SLOW, last) if not choice.sessions]
    if not told:
        return findings
    log.info("valve and body are examined again about slow gauges: %s", _labels(told))
    for found in _valves_with_slow(told, valve, search):
        again = body(found)
        more = len(found.named) + len(again.named) > len(former.named) + len(last.named)
        if not more and does_as_well(again, last, more=False):
            rivals = [rival for rival in found.rivals if rival.instead_of.name != SLOW]  # none of theirs says what the body does
            why = "the body behind is ahead of what the gauges show, so that they are slow and not the valve alone."
            return [_told(replace(found, rivals=rivals), f"{_labels(told)}: {why}"), again]
    return findings


def _valves_with_slow(told: Sequence[Choice], valve: Valve, search: Search) -> list[Finding]:
    """Return what the valve is with slow gauges, fewest effects first.

    Asked in all their parameters, for the body may tell one in the place of another; and in those it told, for a search that is
    free to give gauges a time may give them the valve's.
    """
    whole = [choice._replace(pinned=()) for choice in told]
    asked = [whole] if whole == told else [whole, told]
    found = (_with_slow(valve(slow), search) for slow in asked)
    return sorted((finding for finding in found if finding is not None), key=lambda finding: len(finding.named))


def _with_slow(valve: Finding, search: Search) -> Finding | None:
    """Return the finding if slow gauges are among its effects, or do as well as one of them, whose place they take; else None."""
    if valve.unknown:
        return None
    if _of(SLOW, valve):
        return valve
    slow = [rival for rival in valve.rivals if rival.choice.name == SLOW and rival.equivalent]
    return punctual(switched(valve, valve.judge, slow[0], "it does as well, and the body tells", search)) if slow else None


def _behind_misreading(findings: list[Finding], body: Body, search: Search) -> list[Finding]:
    """Return the findings with gauges that misread by a factor.

    Asked where the valve gives a chamber's pressure a factor, as its gauge shows, and the body behind needs an effect there, too.
    """
    valve, last = findings
    felt = [named.choice.chamber for named in last.named]
    spans = [named.choice for named in valve.named if _is_span(named.choice)]
    doubted = [choice for choice in spans if choice.chamber >= 0 and choice.chamber in felt]
    misread = _misreading(valve, doubted, search) if doubted else None
    if misread is None:
        return findings
    log.info("the body is examined again behind gauges that may misread: %s", _labels(doubted))
    again = body(misread)
    if len(again.named) >= len(last.named) or not does_as_well(again, last, more=False):
        return findings
    mine = _labels(_of(GAUGE, misread))
    why = f"{mine} takes the place of {_labels(doubted)}: what the gauge shows the body behind it does not feel."
    return [_told(misread, why), again]


def told_of_gauges(findings: Sequence[Finding], parameters: dict[str, float]) -> list[str]:
    """Return a sentence for a factor of all pressures that a valve is said to give, which may as well be that of the gauges."""
    stiff = {name: parameters[name] for name in STIFFNESS if name in parameters}
    found = []
    for named in findings[0].named if stiff else ():
        if _is_span(named.choice) and named.choice.chamber < 0 and not named.choice.gate and not named.choice.sessions:
            factor = named.intervals[0].value
            felt = "softer" if factor > 1.0 else "stiffer"
            body = ", ".join(f"{name} {value / factor:.3g} for {value:.3g}" for name, value in stiff.items())
            found.append(
                f"Only gauges say that the pressures are {factor:.3g} times what was commanded. If they misread by that factor "
                f"(pressure_sensor), which no recording can tell from it, the body is as much {felt}: {body}."
            )
    return found


def _is_span(choice: Choice) -> bool:
    return choice.name == SPAN and choice.before_gauge and not (choice.gate and choice.gate.field == "above_share")


def _of(name: str, finding: Finding) -> list[Choice]:
    return [named.choice for named in finding.named if named.choice.name == name]


def _labels(choices: Sequence[Choice]) -> str:
    return ", ".join(choice.label() for choice in choices)


def _told(valve: Finding, why: str) -> Finding:
    log.info("%s", why)
    return replace(valve, switched=(*valve.switched, why))


def _misreading(valve: Finding, doubted: Sequence[Choice], search: Search) -> Finding | None:
    """Return the finding with gauges that misread in the place of the ``doubted`` factors, fitted again."""
    swapped = {
        choice: choice._replace(name=GAUGE, pinned=(*choice.pinned_widths, "offset"), before_gauge=False)
        for choice in doubted
    }
    final, problem, judge = valve.final, valve.part.problem, valve.judge
    effects = tuple(swapped.get(choice, choice) for choice in final.hypothesis.effects)
    task = Hypothesis(effects, final.hypothesis.tuned), [_point(final, swapped)]
    for trial in fit_trials(problem, judge.problem, [task], search):
        mine = by_effect(trial.hypothesis, intervals(problem, trial, judge.thresholds))
        choices = [swapped.get(named.choice, named.choice) for named in valve.named]
        named = [old._replace(choice=new, intervals=mine[new], pinned=()) for old, new in zip(valve.named, choices, strict=True)]
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
