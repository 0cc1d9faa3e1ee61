"""What changed between two sessions is named for the one in which it acted, and nothing is where nothing did."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.data import Data, prepare
from softrl.diagnosis.fitting.choices import in_some_sessions
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, Space
from softrl.diagnosis.stage import run
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import RecordingSet
from tests.diagnosis.conftest import configured, made

STIFFER = effect_class("stiffness_scale")(scale=1.3)
FEW = {"candidates": ["stiffness_scale", "payload"], "search": {"max_effects": 1, "keep": 3}}


def two_days(body: PccSimulator, *, changed: bool) -> RecordingSet:
    """Return three runs a day; on the first the body is stiffer if ``changed``."""
    first = made(body, (STIFFER,) if changed else (), seed=1, sessions=3)
    second = made(body, seed=2, sessions=3)
    runs = [replace(r, session="first") for r in first.recordings]
    runs += [replace(r, session="second", name=f"later_{r.name}") for r in second.recordings]
    return replace(first, recordings=tuple(runs))


def test_an_effect_of_one_session_acts_there_only(body: PccSimulator) -> None:
    hypothesis = Hypothesis((Choice("lag"), Choice("stiffness_scale", sessions=("first",))), ())
    space = Space(hypothesis, body, 4.0)
    point = np.zeros(len(space.axes))
    assert [e.name() for e in space.effects(point, "first")] == ["lag", "stiffness_scale"]
    assert [e.name() for e in space.effects(point, "second")] == ["lag"]


def test_only_a_session_that_is_fitted_and_judged_can_show_such_an_effect() -> None:
    names, days = ["stiffness_scale", "lag"], ["a", "b"]
    assert in_some_sessions(names, ["a", "a", "b", "b"], days, days) == [Choice("stiffness_scale", sessions=("a",))]
    assert in_some_sessions(names, ["a", "b", "b"], days, days) == []
    assert in_some_sessions(names, ["a", "a", "b", "b"], ["c"], [*days, "c"]) == []  # of what goes on the others tell
    seen = [Choice("frame", sessions=(s,)) for s in ("b", "a")]  # the simulator knows where the camera should stand
    assert in_some_sessions(["frame"], ["a", "a", "b", "b"], days, days) == seen


@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        pytest.param("base_tilt", {"about_x_rad": 0.1, "about_y_rad": -0.06}, marks=pytest.mark.slow),
        pytest.param("frame", {"turn_y_rad": 0.06, "shift_x": 0.03}, marks=pytest.mark.slow),
        pytest.param("marker_offset", {"x": 0.05}, marks=pytest.mark.slow),
        ("payload", {"mass": 0.6}),
    ],
)
def test_what_came_between_two_days_is_told_of_the_second(body: PccSimulator, name: str, hidden: dict[str, float]) -> None:
    changed = replace(effect_class(name).neutral(), **hidden)
    first, second = made(body, seed=1, sessions=3), made(body, (changed,), seed=2, sessions=3)
    runs = [replace(r, session="first") for r in first.recordings]
    runs += [replace(r, session="second", name=f"later_{r.name}") for r in second.recordings]
    few = FEW | {"candidates": ["stiffness_scale", "payload", "mount_tilt", "base_tilt", "frame", "marker_offset"]}
    found = run(configured(**few), body.robot, replace(first, recordings=tuple(runs)), body, tracker=NullTracker())
    assert [(e["name"], e["sessions"]) for e in found.effects] == [(name, ["second"])], found.sentences
    assert [e["name"] for e in found.named()] == [name]  # it is so still
    told = found.effects[0]["parameters"]
    for key, value in hidden.items():
        assert told[key]["low"] - 0.005 <= value <= told[key]["high"] + 0.005, told


def test_a_body_stiffer_on_one_day_is_told_with_the_day(body: PccSimulator) -> None:
    found = run(configured(**FEW), body.robot, two_days(body, changed=True), body, tracker=NullTracker())
    assert [(e["name"], e["sessions"]) for e in found.effects] == [("stiffness_scale", ["first"])], found.sentences
    scale = found.effects[0]["parameters"]["scale"]
    assert scale["low"] <= 1.3 <= scale["high"] or abs(scale["value"] - 1.3) < 0.02
    assert "session first only" in found.sentences[0]
    assert found.named() == []


def test_what_acted_on_a_day_that_is_held_out_whole_is_looked_for_on_that_day(body: PccSimulator) -> None:
    days, config, loaded = ("monday", "tuesday", "friday"), configured(**FEW), (effect_class("payload")(mass=0.6),)

    def recorded(odd: str) -> RecordingSet:
        sets = [made(body, loaded if day == odd else (), seed=k, sessions=3) for k, day in enumerate(days)]
        named = [[replace(r, session=d, name=f"{d}_{r.name}") for r in s.recordings] for d, s in zip(days, sets, strict=True)]
        return replace(sets[0], recordings=tuple(r for runs in named for r in runs))

    sides = prepare(recorded(""), body.robot, config.heldout_share, config.seed)
    assert isinstance(sides, Data)
    [odd] = set(days) - {run.session for run in sides.training}
    found = run(config, body.robot, recorded(odd), body, tracker=NullTracker())
    assert [(e["name"], e["sessions"]) for e in found.effects] == [("payload", [odd])], found.sentences
    mass = found.effects[0]["parameters"]["mass"]
    assert mass["low"] <= 0.6 <= mass["high"], mass
    assert any(f"Session {odd}, held out whole" in line for line in found.sentences)


def test_equal_days_show_no_difference(body: PccSimulator) -> None:
    found = run(configured(**FEW), body.robot, two_days(body, changed=False), body, tracker=NullTracker())
    assert found.verdict == "nothing missing", found.sentences
