"""Effects that act somewhere alone, and behind a calibration map: found, with where they act."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.choices import candidates, gated
from softrl.diagnosis.fitting.hypothesis import Choice, Gate, Hypothesis, build_effect, effect_axes, neutral, starts
from softrl.diagnosis.fitting.minimise import Fit
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.search.moves import where_it_acts
from softrl.diagnosis.search.slim import pinned, without_gate
from softrl.diagnosis.stage import run
from softrl.effects.frame import Frame
from softrl.effects.gain import Gain
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.leak import Leak
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, made, node


def test_a_gate_begins_where_it_is_told_and_how_suddenly_is_free() -> None:
    form = Choice("leak", gate=Gate("since_s", 12.0))
    assert [axis.name for axis in effect_axes(form)] == ["leak_per_s", "refill_s", "exponent", "over_s", "since_s"]
    for point in (neutral(form), *starts(form)):
        assert effect_axes(form)[-1].physical(float(point[-1])) == pytest.approx(12.0)
    made = build_effect(form, [0.1, 3.0, 1.0, 0.5, 15.0])
    assert (made.since_s, made.over_s) == (15.0, 0.5)
    held = form._replace(pinned=("over_s",))
    assert [axis.name for axis in effect_axes(held)][-2:] == ["exponent", "since_s"]
    assert build_effect(held, [0.1, 3.0, 1.0, 15.0]).over_s == 1.0
    assert not [form for form in gated(Choice("drift"), 30.0, 0.8) if form.gate and form.gate.field == "since_s"]
    fields = [{form.gate.field for form in gated(Choice("gain"), 30.0, highest) if form.gate} for highest in (0.8, 0.0, -0.2)]
    assert fields == [{"since_s", "above_share"}, {"since_s"}, {"since_s"}], "under suction no pressure is above another"


def test_a_gate_without_influence_is_dropped() -> None:
    form = Choice("leak", gate=Gate("since_s", 12.0))
    hypothesis, point = Hypothesis((form,), ()), starts(form)[0]
    trial = Trial(hypothesis, Fit(point, np.zeros(4), np.zeros((4, 5)), 0.0, 1), {}, np.zeros(4), np.zeros(4))
    less, rest, place = pinned(trial, form, "since_s")
    assert less.effects[place] == Choice("leak")
    np.testing.assert_array_equal(rest, point[:-2])
    assert len(rest) == len(effect_axes(less.effects[place]))
    assert without_gate(form._replace(pinned=("exponent", "over_s"))) == Choice("leak", pinned=("exponent",))


def test_in_the_place_of_what_acts_somewhere_alone_others_are_asked_there() -> None:
    old = Choice("friction", gate=Gate("above_share", 0.2))
    hypothesis, point = Hypothesis((old, Choice("lag")), ()), np.r_[starts(old)[0], starts(Choice("lag"))[0]]
    axis = effect_axes(old)[-1]
    point[len(effect_axes(old)) - 1] = axis.scaled(0.45)
    trial = Trial(hypothesis, Fit(point, np.zeros(4), np.zeros((4, len(point))), 0.0, 1), {}, np.zeros(4), np.zeros(4))
    choices = [Choice(name) for name in ("friction", "play", "command_map", "frame", "leak")] + [Choice("play", 1)]
    found = where_it_acts(trial, old, choices)
    assert [choice.name for choice in found] == ["friction", "play", "leak"], "no map, no sensor, no chamber alone"
    assert found[0] == old
    assert all(choice.gate == Gate("above_share", pytest.approx(0.45)) and choice.chamber < 0 for choice in found[1:])
    assert not where_it_acts(trial, Choice("lag"), choices)


def test_an_effect_that_makes_no_sense_for_a_robot_is_no_candidate(tripod: Robot) -> None:
    one = build(node("robot/single_chamber_finger.yaml"), Robot, "robot")
    for robot, excited, offered in ((tripod, (0, 1, 2), True), (tripod, (0, 1), False), (one, (0,), False)):
        names = {choice.name for choice in candidates(["lag", "command_map"], ("valve",), robot, excited)}
        assert ("command_map" in names) == offered


@pytest.mark.parametrize(
    ("hidden", "rivals", "field", "value", "apart"),
    [
        (Leak(0.15, 3.0, since_s=14.0), ["drift", "failure"], "since_s", 14.0, 1.0),
        pytest.param(
            Hysteresis(0.12, 0.02, above_share=0.4), ["friction", "mullins"], "above_share", 0.4, 0.08, marks=pytest.mark.slow
        ),
    ],
)
def test_where_alone_an_effect_acts_is_found(
    body: PccSimulator, hidden: Leak | Hysteresis, rivals: list[str], field: str, value: float, apart: float
) -> None:
    config = configured(candidates=[hidden.name(), *rivals])
    found = run(config, body.robot, made(body, (hidden,), sessions=3), body, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == [hidden.name()], found.sentences
    assert abs(found.effects[0]["parameters"][field]["value"] - value) < apart


def test_what_begins_late_in_one_chamber_is_found_there(body: PccSimulator) -> None:
    config = configured(candidates=["gain", "failure", "lag"])
    recordings = made(body, (Gain(1.15, chamber=1, since_s=14.0),), sessions=3)
    found = run(config, body.robot, recordings, body, tracker=NullTracker())
    assert [(effect["name"], effect["chamber"]) for effect in found.effects] == [("gain", 1)], found.sentences
    assert abs(found.effects[0]["parameters"]["since_s"]["value"] - 14.0) < 1.0


@pytest.mark.parametrize(
    ("hidden", "within"),
    [
        (Frame(0.0, 0.01, 0.05, 0.0, 0.0, 0.0, since_s=14.0, over_s=0.05), (0.05, 0.3)),
        pytest.param(Gain(1.15, since_s=10.0, over_s=6.0), (4.0, 8.0), marks=pytest.mark.slow),
    ],
)
def test_how_suddenly_it_begins_is_told(body: PccSimulator, hidden: Frame | Gain, within: tuple[float, float]) -> None:
    """What is taken to begin within a second leaves jumps where a camera was knocked, and a bend where a wall gave way."""
    config = configured(candidates=[hidden.name(), "mount_tilt", "failure"])
    found = run(config, body.robot, made(body, (hidden,), sessions=3), body, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == [hidden.name()] and found.verdict == "named", found.sentences
    told = found.effects[0]["parameters"]
    assert within[0] <= told["over_s"]["value"] <= within[1]
    assert abs(told["since_s"]["value"] - hidden.since_s) < 0.3 + 0.1 * hidden.over_s


def test_behind_a_calibration_map_physics_is_named_first(body: PccSimulator) -> None:
    mix = np.array([[1.1, 0.05, 0.0], [-0.04, 0.92, 0.03], [0.0, 0.06, 1.04]])

    def mapped(run: Recording) -> Recording:
        return replace(run, pressure_cmd=run.pressure_cmd @ mix.T + 800.0)

    recordings = made(body, (Lag(0.3, 0.5, chamber=1),), process=mapped, sessions=3)
    config = configured(candidates=["lag", "leak", "command_map"])
    found = run(config, body.robot, recordings, body, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == ["lag", "command_map"], found.sentences
    assert found.effects[0]["chamber"] == 1
    assert found.effects[0]["parameters"]["fill_s"]["value"] == pytest.approx(0.3, rel=0.1)


def test_an_effect_is_found_by_its_name_in_whatever_form_it_acts() -> None:
    knee = Choice("knee", 1, ("above",))
    hypothesis = Hypothesis((Choice("lag"), knee), ())
    assert hypothesis.named("knee") == knee
    assert hypothesis.named("friction") is None
