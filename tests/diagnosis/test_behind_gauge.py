"""A line from the gauge to the chambers is told as one: no gauge shows it, and the valve before it is another."""

import pytest

from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.choices import candidates
from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.diagnosis.stage import run
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

Lag = effect_class("lag")
FEW = {"candidates": ["lag", "delay", "gain", "viscoelasticity"], "search": {"max_effects": 2, "keep": 4}}


def test_only_a_body_that_was_examined_behind_its_gauges_is_offered_such_lines(body: PccSimulator) -> None:
    behind = candidates(["lag"], ("chamber", "body", "load", "sensor"), body.robot, (0,))
    assert behind == [Choice("lag", behind_gauge=True)]
    assert behind[0].site == "chamber" and behind[0].label() == "lag (behind the gauge)"
    assert candidates(["lag"], ("valve", "chamber"), body.robot, (0,)) == [Choice("lag")]
    with pytest.raises(ConfigError, match="behind_gauge"):
        effect_class("gain").neutral(behind_gauge=True)


def test_valve_and_line_are_told_apart(body: PccSimulator) -> None:
    hidden = Lag(fill_s=0.15, vent_s=0.25), Lag(fill_s=0.08, vent_s=0.08, chamber=1, behind_gauge=True)
    recordings = made(body, hidden, seed=3, sessions=5, measured=True)
    found = run(configured(**FEW), body.robot, recordings, body, tracker=NullTracker())
    told = {(e["name"], e["chamber"], e["site"]): e for e in found.effects}
    assert set(told) == {("lag", -1, "valve"), ("lag", 1, "chamber")}, found.sentences
    assert told["lag", 1, "chamber"]["parameters"]["fill_s"]["value"] == pytest.approx(0.08, abs=0.02)
    assert told["lag", -1, "valve"]["parameters"]["fill_s"]["value"] == pytest.approx(0.15, abs=0.02)
    assert "behind the gauge" in told["lag", 1, "chamber"]["where"] and told["lag", 1, "chamber"]["pinned"]["behind_gauge"]
