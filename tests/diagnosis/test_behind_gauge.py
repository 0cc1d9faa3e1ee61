"""A line from the gauge to the chambers is told as one: no gauge shows it, and the valve before it is another."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.data import Data, prepare
from softrl.diagnosis.fitting.choices import candidates
from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.diagnosis.judging.gauges import told_of_gauges
from softrl.diagnosis.stage import _valve, _whole, run
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

Gain, Lag, Offset = (effect_class(name) for name in ("gain", "lag", "offset"))
GaugeLag, PressureSensor = (effect_class(name) for name in ("gauge_lag", "pressure_sensor"))
FEW = {"candidates": ["lag", "delay", "gain", "viscoelasticity"], "search": {"max_effects": 2, "keep": 4}}
SPANS = {"candidates": ["lag", "gain", "pressure_sensor", "viscoelasticity"], "search": {"max_effects": 2, "keep": 3}}


def test_only_a_body_that_was_examined_behind_its_gauges_is_offered_such_lines(body: PccSimulator) -> None:
    behind = candidates(["lag"], ("chamber", "body", "load", "sensor"), body.robot, (0,))
    assert behind == [Choice("lag", behind_gauge=True)]
    assert behind[0].site == "chamber" and behind[0].label() == "lag (behind the gauge)"
    assert candidates(["lag"], ("valve", "chamber"), body.robot, (0,)) == [Choice("lag")]
    with pytest.raises(ConfigError, match="behind_gauge"):
        effect_class("gain").neutral(behind_gauge=True)


@pytest.mark.parametrize(("factor", "told"), [(0.8, "as much stiffer: bending_stiffness_scale 1.25 for 1"),
                                              (1.25, "as much softer: bending_stiffness_scale 0.8 for 1")])  # fmt: skip
def test_behind_gauges_that_show_too_little_the_body_is_stiffer(factor: float, told: str) -> None:
    span = SimpleNamespace(choice=Choice("gain", before_gauge=True), intervals=[SimpleNamespace(value=factor)])
    valve: Any = SimpleNamespace(named=[span])
    assert told in told_of_gauges([valve], {"bending_stiffness_scale": 1.0})[0]


def test_valve_and_line_are_told_apart(body: PccSimulator) -> None:
    hidden = Lag(fill_s=0.15, vent_s=0.25), Lag(fill_s=0.08, vent_s=0.08, chamber=1, behind_gauge=True)
    recordings = made(body, hidden, seed=3, sessions=5, measured=True)
    found = run(configured(**FEW), body.robot, recordings, body, tracker=NullTracker())
    told = {(e["name"], e["chamber"], e["site"]): e for e in found.effects}
    assert set(told) == {("lag", -1, "valve"), ("lag", 1, "chamber")}, found.sentences
    assert told["lag", 1, "chamber"]["parameters"]["fill_s"]["value"] == pytest.approx(0.08, abs=0.02)
    assert told["lag", -1, "valve"]["parameters"]["fill_s"]["value"] == pytest.approx(0.15, abs=0.02)
    assert "behind the gauge" in told["lag", 1, "chamber"]["where"] and told["lag", 1, "chamber"]["pinned"]["behind_gauge"]


def test_a_regulator_s_dead_zone_and_span_are_told_by_a_gauge_that_may_be_off_itself(body: PccSimulator) -> None:
    """Neither does much alone, and of an offset its dead zone is all that such a gauge shows."""
    hidden = Offset(offset=-0.08, before_gauge=True), Gain(gain=1.09, before_gauge=True)
    body = replace(body, robot=replace(body.robot, pressure_min_pa=0.0))
    recordings = made(body, hidden, seed=5, sessions=4, measured=True)
    few = FEW | {"candidates": ["offset", "gain", "knee", "lag", "leak", "deadband"]}
    found = run(configured(**few), body.robot, recordings, body, tracker=NullTracker())
    told = {e["name"]: e["parameters"] for e in found.effects if e["site"] == "valve"}
    assert set(told) == {"offset", "gain"}, found.sentences
    low, high = told["offset"]["offset"]["low"], told["offset"]["offset"]["high"]
    assert low <= -0.08 * 1.09 <= high or low <= -0.08 <= high  # whichever comes first


def test_a_gauge_that_misreads_is_one_effect_and_not_two_that_undo_each_other(body: PccSimulator) -> None:
    hidden = Lag(fill_s=0.15, vent_s=0.25), PressureSensor(gain=1.15, offset=0.0, chamber=1)
    found = run(configured(**SPANS), body.robot, made(body, hidden, seed=3, measured=True), body, tracker=NullTracker())
    assert [(e["name"], e["chamber"]) for e in found.effects] == [("lag", -1), ("pressure_sensor", 1)], found.sentences
    assert found.effects[1]["parameters"]["gain"]["value"] == pytest.approx(1.15, abs=0.005)
    assert found.errors_mm["heldout"]["corrected"] < 1.2 * found.errors_mm["heldout"]["noise_floor"]


@pytest.mark.slow
def test_a_span_of_the_regulator_and_a_weaker_chamber_behind_it_stay_two(body: PccSimulator) -> None:
    hidden = Gain(gain=1.15, chamber=1, before_gauge=True), Gain(gain=0.75, chamber=1)
    found = run(configured(**SPANS), body.robot, made(body, hidden, seed=3, measured=True), body, tracker=NullTracker())
    told = [(e["name"], e["site"], round(e["parameters"]["gain"]["value"], 2)) for e in found.effects]
    assert told == [("gain", "valve", 1.15), ("gain", "chamber", 0.75)], found.sentences


def test_that_all_gauges_may_misread_alike_is_told_with_what_the_body_would_be(body: PccSimulator) -> None:
    hidden = (PressureSensor(gain=1.1, offset=0.0),)
    found = run(configured(**SPANS), body.robot, made(body, hidden, seed=3, measured=True), body, tracker=NullTracker())
    assert [(e["name"], e["site"]) for e in found.effects] == [("gain", "valve")], found.sentences
    told = next(line for line in found.sentences if line.startswith("Only gauges say that the pressures are 1.1 times"))
    softer = [float(part.split(" for ")[0].split()[-1]) for part in told.split("softer: ")[1].split(", ")]
    assert softer == pytest.approx([1.0, 1.0], abs=0.02), told


@pytest.mark.parametrize("chamber", [-1, pytest.param(1, marks=pytest.mark.slow)])
def test_a_slow_gauge_is_no_second_lag_of_the_valve(body: PccSimulator, chamber: int) -> None:
    """The valve's part alone cannot tell the two lags apart; the body, which is ahead of what the gauge shows, does."""
    hidden = Lag(fill_s=0.15, vent_s=0.25), GaugeLag(time_s=0.1, chamber=chamber)
    few = {"candidates": ["lag", "gauge_lag", "pi_regulator", "leak", "gain"], "search": {"max_effects": 2, "keep": 4}}
    found = run(configured(**few), body.robot, made(body, hidden, seed=3, measured=True), body, tracker=NullTracker())
    told = {(e["name"], e["chamber"]): e["parameters"] for e in found.effects}
    assert set(told) == {("lag", -1), ("gauge_lag", chamber)} and found.verdict == "named", found.sentences
    assert told["gauge_lag", chamber]["time_s"]["value"] == pytest.approx(0.1, rel=0.1)
    assert told["lag", -1]["fill_s"]["value"] == pytest.approx(0.15, rel=0.05)
    assert found.errors_mm["heldout"]["corrected"] < 1.2 * found.errors_mm["heldout"]["noise_floor"]


@pytest.mark.slow
def test_where_only_the_gauge_is_slow_the_valve_is_quick(body: PccSimulator) -> None:
    few = {"candidates": ["lag", "gauge_lag", "tube_line", "rate_limit"], "search": {"max_effects": 2, "keep": 4}}
    hidden = (GaugeLag(time_s=0.15),)
    found = run(configured(**few), body.robot, made(body, hidden, seed=3, measured=True), body, tracker=NullTracker())
    assert [(e["name"], e["site"]) for e in found.effects] == [("gauge_lag", "sensor")], found.sentences
    assert found.effects[0]["parameters"]["time_s"]["value"] == pytest.approx(0.15, rel=0.05)
    assert found.errors_mm["heldout"]["corrected"] < 1.2 * found.errors_mm["heldout"]["noise_floor"]


@pytest.mark.slow
def test_a_gauge_that_is_read_late_takes_nothing_of_the_valve_s_lag(body: PccSimulator) -> None:
    """Free to give the gauge a time as well, a search gave it the valve's, and found nothing that fits beside it.

    The delay is known to within a row (20 ms), for it is not said when rows act.
    """
    few = {"candidates": ["lag", "gauge_lag", "dead_time", "tube_line", "flow_limit", "orifice", "knee"]}
    hidden = Lag(fill_s=0.3, vent_s=0.5), GaugeLag(time_s=0.0, delay_s=0.1)
    found = run(configured(**few), body.robot, made(body, hidden, seed=3, measured=True), body, tracker=NullTracker())
    told = {e["name"]: e["parameters"] for e in found.effects}
    assert set(told) == {"lag", "gauge_lag"} and found.verdict == "named", found.sentences
    assert 0.078 < told["gauge_lag"]["delay_s"]["value"] < 0.102
    assert [told["lag"][key]["value"] for key in ("fill_s", "vent_s")] == pytest.approx([0.3, 0.5], rel=0.05)


def test_a_regulator_that_was_off_on_one_day_alone_is_told_with_the_day(body: PccSimulator) -> None:
    """No failure that ends, and no gain of the other days."""
    off = Gain(gain=0.7, chamber=1, before_gauge=True)
    days = [made(body, acts, seed=seed, sessions=4, measured=True) for seed, acts in ((1, (off,)), (2, ()))]
    runs = [
        replace(recording, session=day, name=f"{day}_{recording.name}")
        for day, found in zip(("first", "second"), days, strict=True)
        for recording in found.recordings
    ]
    config = configured(candidates=["lag", "gain", "failure"], search={"max_effects": 2, "keep": 4})
    data = prepare(replace(days[0], recordings=tuple(runs)), body.robot, config.heldout_share, config.seed)
    assert isinstance(data, Data)
    whole, data = _whole(config, body.robot, body, data, config.numerics)
    finding = _valve(config, whole, data)
    (named,) = finding.named
    assert named.choice == Choice("gain", 1, sessions=("first",), before_gauge=True) and not finding.unknown
    assert named.intervals[0].value == pytest.approx(0.7, abs=0.002)
