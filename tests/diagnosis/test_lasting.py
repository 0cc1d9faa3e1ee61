"""What fails, or ages, and stays so: its time goes on from run to run."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.choices import that_last
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, Space
from softrl.diagnosis.stage import run
from softrl.effects.drift import Drift
from softrl.effects.effect import Effect
from softrl.effects.failure import Failure
from softrl.effects.frame import Frame
from softrl.effects.leak import Leak
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.gone import in_order
from softrl.recordings.recording import Recording, RecordingSet
from tests.diagnosis.conftest import configured, made

TURNED = replace(Frame.neutral(), turn_y_rad=0.06)
FEW = {"candidates": ["failure", "drift", "gain", "stiffness_scale", "lag"], "search": {"keep": 3}}


def blank(session: str, first_s: float, last_s: float) -> Recording:
    time = np.linspace(first_s, last_s, 11)
    return Recording(session, session, time, np.zeros((11, 3)))


def days(body: PccSimulator, effect: Effect, *, until: str) -> RecordingSet:
    """Return two days of three runs; the clock of ``effect`` goes on through all, or stops to act after the first day."""
    sound = [replace(r, session=day) for day, seed in (("first", 1), ("second", 2))
             for r in made(body, seed=seed, sessions=3).recordings]  # fmt: skip
    runs = []
    for number, (sound_run, gone) in enumerate(zip(sound, in_order(sound), strict=True)):
        effects = (replace(effect, begun_s=gone.gone_s[-1]),) if until == "ever" or gone.session == "first" else ()
        seed = 1 if gone.session == "first" else 2
        found = made(body, effects, seed=seed, sessions=3).recordings[number % 3]
        runs.append(replace(found, session=sound_run.session, name=f"{sound_run.session}_{found.name}"))
    return RecordingSet(body.robot.name, tuple(runs))


def test_time_goes_on_from_run_to_run() -> None:
    runs = [blank("a", 0.0, 10.0), blank("a", 0.0, 5.0), blank("b", 100.0, 110.0), blank("b", 130.0, 135.0)]
    assert [r.gone_s for r in in_order(runs)] == [(0, 0, 0), (0, 10, 10), (0, 0, 15), (0, 30, 45)]


def test_what_no_later_run_shows_is_not_offered() -> None:
    choice = [Choice("failure", 1), Choice("lag")]
    assert that_last(choice, ["a"], ["b"]) == []
    assert that_last(choice, ["a", "a"], ["a"]) == [Choice("failure", 1, lasting="ever")]
    both = [Choice("failure", 1, lasting="ever"), Choice("failure", 1, lasting="session", sessions=("a",))]
    assert that_last(choice, ["a", "a", "b", "b"], ["a", "b"]) == both


def test_a_clock_goes_on_where_something_lasts(body: PccSimulator) -> None:
    for lasting, begun in (("", 2.0), ("session", 7.0), ("ever", 40.0)):
        space = Space(Hypothesis((Choice("failure", 1, lasting=lasting),), ()), body, 4.0)
        assert space.effects(np.zeros(2), "a", (2.0, 7.0, 40.0))[0].begun_s == begun


def test_a_chamber_that_fails_and_stays_so_that_day(body: PccSimulator) -> None:
    recordings = days(body, Failure(0.4, onset_s=14.0, chamber=1), until="session")
    found = run(configured(**FEW), body.robot, recordings, body, tracker=NullTracker())
    assert [(e["name"], e["chamber"], e["sessions"], e["lasting"]) for e in found.effects] == [
        ("failure", 1, ["first"], "session")
    ], found.sentences
    told = found.effects[0]["parameters"]
    assert abs(told["onset_s"]["value"] - 14.0) < 0.5 and abs(told["loss"]["value"] - 0.4) < 0.02, told
    assert "chamber 2" in found.sentences[0] and "session first only" in found.sentences[0]
    assert found.named() == []  # it was mended: history


def test_a_wall_that_ages_for_ever_and_where_it_is_now(body: PccSimulator) -> None:
    recordings = days(body, Drift(rate_per_s=0.002), until="ever")
    found = run(configured(**FEW), body.robot, recordings, body, tracker=NullTracker())
    assert [(e["name"], e["lasting"]) for e in found.effects] == [("drift", "ever")], found.sentences
    told = found.effects[0]["parameters"]["rate_per_s"]
    assert abs(told["value"] - 0.002) < 2e-4, told
    whole = sum(float(np.ptp(r.time)) for r in recordings.recordings)
    assert abs(found.named()[0]["parameters"]["begun_s"] - whole) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "among", "moment_s"),
    [
        (Leak(0.3, 2.0, chamber=1), ["failure", "drift", "leak", "gain"], 35.0),
        (TURNED, ["frame", "mount_tilt", "lag", "leak"], 82.0),
    ],
)
def test_what_began_at_some_moment_and_stayed_so(body: PccSimulator, effect: Effect, among: list[str], moment_s: float) -> None:
    """It began in a run that fits see; the runs after it show it from their first sample on."""
    recordings = days(body, replace(effect, since_s=moment_s), until="ever")
    few = {"candidates": among, "search": {"keep": 3}}
    found = run(configured(**few), body.robot, recordings, body, tracker=NullTracker())
    assert found.verdict == "named", found.sentences
    assert [(e["name"], e["chamber"], e["lasting"]) for e in found.effects] == [
        (effect.name(), getattr(effect, "chamber", -1), "ever")
    ], found.sentences
    assert not any("held-out runs date it" in line for line in found.sentences)
    told = found.effects[0]["parameters"]["since_s"]
    assert abs(told["value"] - moment_s) < 0.5 and told["high"] - told["low"] < 5.0 and not told["at_bound"], told
    pinned = found.effects[0]["pinned"]
    assert pinned["begun_s"] > moment_s, "what is recorded from now on shows it from the first sample on"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "among", "name"),
    [
        (Leak(0.3, 2.0, chamber=1), ["gain", "leak", "failure", "drift", "mount_tilt"], "since_s"),
        (TURNED, ["frame", "mount_tilt", "lag", "leak", "stiffness_scale"], "since_s"),
        (Failure(0.4, 0.0, chamber=1), ["failure", "drift", "gain", "lag"], "onset_s"),
    ],
)
def test_where_no_fit_sees_when_it_began_the_held_out_run_dates_it(
    body: PccSimulator, effect: Effect, among: list[str], name: str
) -> None:
    """It began in the middle of a run that is held out: fits see the runs before and the runs after it."""
    recordings = days(body, replace(effect, **{name: 60.0}), until="ever")
    found = run(configured(candidates=among, search={"keep": 3}), body.robot, recordings, body, tracker=NullTracker())
    assert "first_run_2" in found.data["heldout_runs"], "its time is 48 to 72 s"
    assert found.verdict == "named" and len(found.effects) == 1, found.sentences
    assert found.effects[0]["chamber"] == getattr(effect, "chamber", -1) and found.effects[0]["lasting"] == "ever"
    told = found.effects[0]["parameters"].get("since_s") or found.effects[0]["parameters"]["onset_s"]
    assert abs(told["value"] - 60.0) < 0.5, told
    assert told["low"] < 49.0 and told["high"] > 71.0, "fits say no more than between which of their runs"
    assert any("held-out runs date it" in line for line in found.sentences)
    assert found.errors_mm["heldout"]["corrected"] < 1.3 * found.errors_mm["heldout"]["noise_floor"]
