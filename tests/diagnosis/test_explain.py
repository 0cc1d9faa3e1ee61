"""The verdict holds what is named to account: a correction that predicts worse than none is no finding."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.core.config import build
from softrl.diagnosis.fitting.hypothesis import Choice, Gate, Hypothesis, Space, effect_axes
from softrl.diagnosis.judging.examine import Days
from softrl.diagnosis.judging.verdict import verdict_of
from softrl.diagnosis.telling.entries import rival_entries, where
from softrl.diagnosis.telling.explain import (
    _at_the_end,
    _but,
    _rival_sentence,
    _rival_sentences,
    _ungauged,
    _verdict_sentence,
    next_experiment,
)
from softrl.diagnosis.telling.parameters import effect_sentence
from softrl.diagnosis.telling.report import _next
from softrl.effects.knee import Knee
from softrl.excite.form import form_of
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.gone import Now
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import node


@pytest.mark.parametrize(
    ("named", "corrected", "verdict"),
    [(True, 1.0, "named"), (True, 4.0, "unknown"), (False, 4.0, "nothing missing")],
)
def test_names_whose_correction_predicts_worse_than_retuning_are_no_verdict(
    named: bool, corrected: float, verdict: str
) -> None:
    finding: Any = SimpleNamespace(named=["lag"] if named else [], unknown=False, rivals=[])
    assert verdict_of([finding], {"noise_floor": 0.1, "retuned": 3.0, "corrected": corrected}) == verdict


@pytest.mark.parametrize(
    ("nominal", "plausible", "told"),
    [(0.36, False, "its own parameters suffice"), (0.36, True, "its own parameters suffice"),
     (0.60, False, "goes to the end of what is plausible (mass_scale 8 for 2)"),
     (0.60, True, "retuned parameters suffice (mass_scale 8 for 2)")],
)  # fmt: skip
def test_an_end_of_the_plausible_range_says_nothing_where_nominal_parameters_do_as_well(
    nominal: float, plausible: bool, told: str
) -> None:
    held = {"nominal": nominal, "retuned": 0.35, "corrected": 0.35, "noise_floor": 0.34}
    entry = {"nominal": 2.0, "value": 8.0, "lowest": 0.5, "highest": 8.0, "plausible": plausible}
    made: Any = SimpleNamespace(verdict="nothing missing", errors_mm={"heldout": held}, effects=[], retuned={"mass_scale": entry})
    assert told in _verdict_sentence(made)


def test_parameters_that_the_correction_too_drives_to_an_end_are_told() -> None:
    made: Any = SimpleNamespace(effects=["lag"])
    assert "With what is named mass_scale, stiffness_scale still ends" in _at_the_end(made, ["mass_scale", "stiffness_scale"])[0]
    assert not _at_the_end(made, []) and not _at_the_end(SimpleNamespace(effects=[]), ["mass_scale"])  # type: ignore[arg-type]


def test_a_valve_without_a_gauge_behind_it_may_lie_elsewhere() -> None:
    def finding(*names: str) -> Any:
        return SimpleNamespace(named=[SimpleNamespace(choice=Choice(name)) for name in names])

    assert "may as well lie between pressure and force" in _ungauged([finding("deadband")])[0]
    assert not _ungauged([finding("payload")])
    assert not _ungauged([finding("deadband"), finding("payload")])  # valve and body apart: a gauge stands between


def test_nothing_missing_says_what_stays_beyond_a_detail_of_the_body() -> None:
    def finding(left: float, days: Any = None) -> Any:
        return SimpleNamespace(left=left, days=days, judge=SimpleNamespace(material=1.0, form=3.0, travel=100.0))

    assert "sessions differ a little" in _but([finding(3.5, Days((), 1.0))], "nothing missing")
    assert "no test tells" in _but([finding(3.5)], "nothing missing")
    assert "2.5% of the motion, as much as a lumped body may err" in _but([finding(2.5)], "nothing missing")
    assert not _but([finding(1.5)], "nothing missing") and not _but([finding(2.5)], "unknown")


@pytest.mark.parametrize(
    ("name", "parameter", "unit", "told"),
    [("deadband", "band", "1", "= 1.05 kPa"), ("rate_limit", "rise_per_s", "1/s", "1/s = 1.05 kPa/s"),
     ("supply_limit", "ceiling", "1", "= 0.9 kPa"), ("payload", "mass", "1", "= 3 g"), ("contact", "distance", "1", "= 6 mm")],
)  # fmt: skip
def test_shares_are_told_in_units_of_the_robot(name: str, parameter: str, unit: str, told: str) -> None:
    robot: Any = SimpleNamespace(command="pressure", largest_pa=35e3, pressure_max_pa=30e3, length_m=0.2, mass_kg=0.1)
    entry = {"value": 0.03, "low": 0.02, "high": 0.04, "unit": unit, "at_bound": False}
    effect = {"name": name, "site": "valve", "where": "all", "parameters": {parameter: entry}, "evidence": "so"}
    assert f"{parameter} 0.03 (0.02 to 0.04)" in effect_sentence(effect, robot) and told in effect_sentence(effect, robot)


@pytest.mark.parametrize(
    ("site", "pinned", "gauged", "told"),
    [
        ("valve", {}, False, "= 27 pump_pwm"),
        ("valve", {}, True, "= 27 pump_pwm"),
        ("valve", {"behind_gauge": True}, True, "= 2.7 kPa"),
        ("chamber", {}, False, "= 27 pump_pwm"),
        ("chamber", {}, True, "= 2.7 kPa"),
    ],
)
def test_a_share_of_what_is_no_pressure_is_told_as_what_is_commanded(
    site: str, pinned: dict[str, Any], gauged: bool, told: str
) -> None:
    """A pump's duty cycle is stored in Pa by a scale that means nothing; behind a gauge there are pressures."""
    finger = build(node("robot/single_chamber_finger.yaml"), Robot, "robot")
    entry = {"value": 0.1, "low": 0.08, "high": 0.12, "unit": "1", "at_bound": False}
    effect = {"name": "offset", "site": site, "where": "all", "parameters": {"offset": entry}, "pinned": pinned, "evidence": "so"}
    assert f"offset 0.1 (0.08 to 0.12) {told}." in effect_sentence(effect, finger, gauged)


def test_an_interval_has_the_digits_that_tell_its_ends_apart() -> None:
    robot: Any = SimpleNamespace(command="pressure", largest_pa=35e3, pressure_max_pa=30e3, length_m=0.2, mass_kg=0.1)
    for value, low, high, told in [(0.12003, 0.11991, 0.12014, "0.1200 (0.1199 to 0.1201) s"),
                                   (0.3, 0.21, 0.41, "0.3 (0.21 to 0.41) s"), (0.5, 0.5, 0.5, "0.5 (0.5 to 0.5) s")]:  # fmt: skip
        entry = {"value": value, "low": low, "high": high, "unit": "s", "at_bound": False}
        effect = {"name": "lag", "site": "valve", "where": "all", "parameters": {"fill_s": entry}, "evidence": "so"}
        assert f"fill_s {told}" in effect_sentence(effect, robot)


@pytest.mark.parametrize(("choice", "told"), [
    (Choice("gain"), "all chambers"), (Choice("payload"), "tip"), (Choice("lag"), "all chambers"),
    (Choice("gain", 1, gate=Gate("since_s", 5.0)), "chamber 2, from a time on"),
    (Choice("gain", sessions=("monday",)), "session monday only"),
    (Choice("gain", sessions=("monday",), before_gauge=True), "session monday only, before the gauge"),
    (Choice("drift", sessions=("monday",), lasting="session"),
     "lasting through a session (its time counts from the session's first run), session monday only"),
    (Choice("drift", 0, sessions=("monday",), lasting="session"),
     "chamber 1, lasting through a session (its time counts from the session's first run), session monday only"),
])  # fmt: skip
def test_where_an_effect_acts_is_told_whole_in_one_session_too(choice: Choice, told: str) -> None:
    assert where(choice) == told


@pytest.mark.parametrize(
    ("gap", "equivalent", "contests", "told"),
    [(0.02, True, True, "cannot be told from lag: its held-out error is larger by 0.02 mm (-0.1 to 0.2)"),
     (-0.01, True, False, "does no better than lag: its held-out error is smaller by 0.01 mm (-0.2 to 0.1)"),
     (-0.01, False, False, "fits all runs together no better than lag: its held-out error is smaller"),
     (0.004, False, False, "is hardly worse held out"),
     (0.3, False, False, "is worse than lag")],
)  # fmt: skip
def test_only_what_contests_cannot_be_told_apart(gap: float, equivalent: bool, contests: bool, told: str) -> None:
    row = {"name": "rate_limit", "instead_of": "lag", "score_gap": gap, "low": 0.1 if gap > 0.1 else -0.1,
           "high": 0.2, "unit": "mm"}  # fmt: skip
    assert told in _rival_sentence(row | {"equivalent": equivalent, "contests": contests})


def test_an_alternative_that_contests_is_told_first_whatever_its_unit(body: PccSimulator) -> None:
    def rival(name: str, gap: float, contests: bool) -> Any:
        hypothesis = Hypothesis((Choice(name),), ())
        trial = SimpleNamespace(hypothesis=hypothesis, fit=SimpleNamespace(point=np.zeros(len(effect_axes(Choice(name))))))
        return SimpleNamespace(choice=Choice(name), instead_of=Choice("gain"), gap=SimpleNamespace(value=gap, low=gap, high=gap),
                               equivalent=contests, contests=contests, trial=trial)  # fmt: skip

    def finding(target: str, material: float, rivals: list[Any]) -> Any:
        problem = SimpleNamespace(target=target, robot=body.robot, space=lambda hypothesis: Space(hypothesis, body, 4.0))
        part = SimpleNamespace(problem=problem, now=Now("tuesday", (0.0, 0.0, 0.0)))
        return SimpleNamespace(part=part, rivals=rivals, judge=SimpleNamespace(material=material))

    valve = finding("pressure", 1000.0, [rival("lag", 500.0, True), rival("leak", 150.0, False)])
    motion = finding("motion", 1e-3, [rival(name, 1e-4 * (k + 1), False) for k, name in enumerate(("frame", "payload", "drift"))])
    rows = rival_entries([valve, motion], body.robot)
    assert [row["name"] for row in rows] == ["lag", "frame", "leak", "payload", "drift"]  # 0.5 kPa; 0.1 mm, 0.15 kPa, 0.2, 0.3 mm
    told = _rival_sentences([*rows[1:], rows[0], rows[-1]])
    assert len(told) == 5 and told[-1].startswith("lag cannot be told from gain")


def unknown(robot: Any, gauged: bool, parts: int = 1) -> list[Any]:
    """Return findings of which no effect explains what is left, though two fit it alike."""
    lag, play = Choice("dead_time"), Choice("delay")
    rivals = [SimpleNamespace(choice=play, instead_of=lag, contests=True)]
    run = SimpleNamespace(pressure_meas=np.zeros((9, 3)) if gauged else None)
    part = SimpleNamespace(problem=SimpleNamespace(runs=[run], robot=robot))
    named = [SimpleNamespace(choice=lag)]
    return [SimpleNamespace(rivals=rivals, named=named, unknown=True, part=part) for _ in range(parts)]


@pytest.mark.parametrize(
    ("gauged", "parts", "first"),
    [(False, 1, "steps and a multisine of one chamber with the chamber's pressure measured; then the same triangle"),
     (True, 1, "the same triangle"), (True, 2, "steps and a multisine of one chamber")],
)  # fmt: skip
def test_after_unknown_the_valve_is_measured_first_where_no_gauge_clears_it(
    body: PccSimulator, gauged: bool, parts: int, first: str
) -> None:
    made = next_experiment(unknown(body.robot, gauged, parts), "unknown", body.robot, 1e-4)
    assert made is not None and made["program"].startswith(first)
    assert made["separates"] == [] and "duration_s" not in made  # it tells no two apart, and nobody has added up its time
    assert made["pressure_max_pa"] == body.robot.pressure_max_pa


def test_what_is_no_pressure_has_the_limits_of_its_own_command(body: PccSimulator) -> None:
    robot = replace(body.robot, command="pump_pwm", command_to_pa=100.0)
    made = next_experiment(unknown(robot, True), "unknown", robot, 1e-4)
    assert made is not None and "pressure_max_pa" not in made
    assert (made["pump_pwm_min"], made["pump_pwm_max"]) == (0.01 * robot.pressure_min_pa, 0.01 * robot.pressure_max_pa)


@pytest.mark.parametrize(("contests", "duration_s", "told"), [
    (False, None, "turn it."), (True, None, "turn it (<code>stage=excite</code> writes a program)."),
    (True, 40.0, "turn it (40 s; <code>stage=excite</code> writes a program)."),
])  # fmt: skip
def test_a_program_is_promised_only_where_two_hypotheses_are_open(contests: bool, duration_s: float | None, told: str) -> None:
    wanted = {"program": "turn it"} | ({} if duration_s is None else {"duration_s": duration_s})
    found: Any = SimpleNamespace(next_experiment=wanted, rivals=[{"contests": contests}])
    assert _next(found) == [told]


def test_what_begins_within_the_shortest_time_begins_at_once() -> None:
    entry = {"value": 0.05, "low": 0.05, "high": 0.2, "unit": "s", "at_bound": True}
    effect = {"name": "frame", "site": "sensor", "where": "pose sensor", "parameters": {"over_s": entry}, "evidence": "so"}
    robot: Any = SimpleNamespace(command="pressure", largest_pa=35e3, pressure_max_pa=30e3, length_m=0.2, mass_kg=0.1)
    assert "over_s 0.05 (0.05 to 0.2) s, at once" in effect_sentence(effect, robot)


def test_alternatives_are_told_as_they_were_fitted_so_that_a_program_can_be_planned(body: PccSimulator) -> None:
    named = Choice("gain", 1)
    gated = Choice("knee", 1, ("slope",), Gate("since_s", 5.0), before_gauge=True)
    lasting = Choice("failure", 2, sessions=("monday",), lasting="ever")
    problem = SimpleNamespace(target="pressure", space=lambda hypothesis: Space(hypothesis, body, 4.0))

    def rival(choice: Choice, values: list[float]) -> Any:
        hypothesis = Hypothesis((Choice("lag"), choice), ())
        point = [0.0, 0.0, *(axis.scaled(v) for axis, v in zip(effect_axes(choice), values, strict=True))]
        gap = SimpleNamespace(value=values[-1], low=0.0, high=1.0)
        trial = SimpleNamespace(hypothesis=hypothesis, fit=SimpleNamespace(point=np.array(point)))
        return SimpleNamespace(choice=choice, instead_of=named, gap=gap, equivalent=True, contests=True, trial=trial)

    rivals = [rival(gated, [0.7, 0.5, 12.0]), rival(lasting, [0.3, 40.0])]
    part = SimpleNamespace(problem=problem, now=Now("tuesday", (0.0, 30.0, 60.0)))
    finding: Any = SimpleNamespace(part=part, rivals=rivals, judge=SimpleNamespace(material=1.0))
    rows = rival_entries([finding], body.robot)
    first, second = (row["effect"] for row in rows)
    assert first["parameters"] == pytest.approx({"threshold": 0.7, "over_s": 0.5, "since_s": 12.0})
    assert first["pinned"] == {"slope": 1.0, "before_gauge": True} and not first["past"]
    assert second["past"] and second["pinned"] == {"begun_s": 60.0} and second["lasting"] == "ever"
    assert form_of(rows[0]["replaces"]).same_as(form_of({"name": "gain", "chamber": 1}))
    made = form_of(json.loads(json.dumps(first))).build()
    assert isinstance(made, Knee) and (made.slope, made.chamber, made.before_gauge) == (1.0, 1, True)
    assert (made.threshold, made.over_s, made.since_s) == pytest.approx((0.7, 0.5, 12.0))
