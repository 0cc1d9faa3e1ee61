"""What acts from a session on, in one, or up to one: named with its sessions, each run a session of its own or not."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.choices import alike, in_some_sessions, periods
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import fit_trials
from softrl.diagnosis.search.look import bases_of
from softrl.diagnosis.search.periods import likely
from softrl.diagnosis.stage import run
from softrl.effects.effect import Effect
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import RecordingSet
from tests.diagnosis.conftest import configured, made

DAYS = [f"day_{number}" for number in range(8)]
NAMES = ["stiffness_scale", "payload", "mount_tilt", "frame", "drift", "lag", "gain", "failure"]
FEW = {"candidates": NAMES, "search": {"keep": 3}}


def changed(body: PccSimulator, effect: Effect, days: list[str]) -> RecordingSet:
    """Return eight days of one run each; ``effect`` acts on ``days``."""
    without, acting = (made(body, effects, seed=3, sessions=len(DAYS)) for effects in ((), (effect,)))
    pairs = zip(without.recordings, acting.recordings, strict=True)
    return replace(without, recordings=tuple(b if b.session in days else a for a, b in pairs))


def test_periods_go_on_to_the_end_or_from_the_beginning_or_are_one_session() -> None:
    assert periods(["a", "b", "c"]) == [("b", "c"), ("a", "b"), ("c",), ("a",), ("b",)]
    assert periods(["a", "b"]) == [("b",), ("a",)] and periods(["a"]) == []


def test_two_runs_are_fitted_on_either_side_and_one_judges() -> None:
    training, heldout = ["a", "b", "d", "e"], ["c", "f"]
    assert {choice.sessions for choice in in_some_sessions(["frame"], training, heldout, list("abcdef"))} == {
        ("c", "d", "e", "f"), ("a", "b", "c")
    }  # fmt: skip
    forms = alike(Choice("frame", sessions=("a", "b", "c")), training, list("abcdef"))
    assert [form.sessions for form in forms] == [("a", "b", "c"), ("a", "b")], "no fit tells these apart"
    assert {choice.sessions for choice in in_some_sessions(["stiffness_scale"], training, heldout, list("abcdef"))} == {
        ("a", "b", "c")
    }, "what retuning does is told of the sessions before"


def test_one_chamber_alone_may_change_with_a_day() -> None:
    training, heldout = ["a", "b", "d", "e"], ["c", "f"]
    offered = in_some_sessions(["gain"], training, heldout, list("abcdef"), [0, 2])
    assert {choice.chamber for choice in offered} == {0, 2}
    assert {choice.sessions for choice in offered} == {("c", "d", "e", "f"), ("a", "b", "c")}, "to the last one, too"
    alone = in_some_sessions(["gain"], training, heldout, list("abcdef"), [1])
    assert {choice.chamber for choice in alone} == {-1}, "of the only chamber all that it weighs tells gain from stiffness"
    assert {choice.sessions for choice in alone} == {("c", "d", "e", "f"), ("a", "b", "c")}
    assert in_some_sessions(["gain"], training, heldout, list("abcdef"), []) == []


def test_gauges_show_what_a_regulator_did_in_some_sessions_alone() -> None:
    days = ["a", "a", "b", "b"]
    offered = in_some_sessions(["gain", "payload", "lag"], days, ["a", "b"], ["a", "b"], [0, 2], gauges_only=True)
    assert offered == [
        Choice("gain", chamber, sessions=(day,), before_gauge=True) for chamber in (-1, 0, 2) for day in ("b", "a")
    ]  # fmt: skip


def test_what_straight_lines_favour_is_the_period_in_which_it_acts(body: PccSimulator) -> None:
    heavy = effect_class("payload")(mass=0.3)
    config, recordings = configured(), changed(body, heavy, DAYS[3:])
    fitting = Problem(body.robot, body, recordings.recordings, config.numerics, "motion", "command", False, False)
    bare = fit_trials(fitting, None, [(Hypothesis((), ()), [np.zeros(0)])], config.search)[0]
    base = bases_of(fitting, bare)[0]
    offered = [Choice("payload", sessions=p) for p in periods(DAYS)] + [Choice("lag")]
    kept = likely(fitting, base, offered)
    assert Choice("payload", sessions=tuple(DAYS[3:])) in kept and Choice("lag") in kept and len(kept) == 3


def test_runs_do_not_know_of_each_other(body: PccSimulator) -> None:
    config, runs = configured(), made(body, seed=3, sessions=3).recordings
    fitting = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    acts = [(Choice("payload", sessions=("day_1",)),), (Choice("payload"),), ()]
    there, everywhere, nowhere = (fitting.residual(Hypothesis(act, ()), np.full(len(act), 0.3)).runs for act in acts)
    for number in range(3):
        np.testing.assert_array_equal(there[number], (everywhere if number == 1 else nowhere)[number])


@pytest.mark.parametrize(
    ("name", "hidden", "days"),
    [
        pytest.param("frame", {"turn_y_rad": 0.06, "shift_x": 0.03}, DAYS[3:], marks=pytest.mark.slow),
        ("payload", {"mass": 0.6}, DAYS[:4]),
        pytest.param("stiffness_scale", {"scale": 1.3}, DAYS[:4], marks=pytest.mark.slow),
        pytest.param("gain", {"gain": 0.82, "chamber": 2}, DAYS[4:], marks=pytest.mark.slow),
    ],
)
def test_what_changed_between_two_of_many_days_is_told_with_them(
    body: PccSimulator, name: str, hidden: dict[str, float], days: list[str]
) -> None:
    effect = replace(effect_class(name).neutral(), **hidden)
    found = run(configured(**FEW), body.robot, changed(body, effect, days), body, tracker=NullTracker())
    assert [e["name"] for e in found.effects] == [name] and found.verdict == "named", found.sentences
    assert found.effects[0]["sessions"] == days, found.sentences
    assert len(found.named()) == (days[-1] == DAYS[-1]), "what is over stays out of the correction"
    for key, value in hidden.items():
        if key == "chamber":
            assert found.effects[0]["chamber"] == value
            continue
        told = found.effects[0]["parameters"][key]
        assert told["low"] - 0.005 <= value <= told["high"] + 0.005, told
