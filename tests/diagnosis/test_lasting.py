"""What fails, or ages, and stays so: its time goes on from run to run."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.choices import that_last
from softrl.diagnosis.fitting.hypothesis import MOMENTS, Choice, Gate, Hypothesis, Space
from softrl.diagnosis.fitting.intervals import _flat, intervals
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import axes_of, fit_trials
from softrl.diagnosis.search.look import bases_of
from softrl.diagnosis.search.moment import at_its_moment
from softrl.diagnosis.search.moves import fit_leads
from softrl.diagnosis.search.onset import PIECES, onsets
from softrl.diagnosis.search.rank import rank
from softrl.diagnosis.stage import run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.drift import Drift
from softrl.effects.effect import Effect
from softrl.effects.failure import Failure
from softrl.effects.frame import Frame
from softrl.effects.gain import Gain
from softrl.effects.leak import Leak
from softrl.effects.replay import replay
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


@pytest.mark.parametrize(
    "choice",
    [
        Choice("gain", 0, gate=Gate("since_s", 5.0), lasting="ever"),
        Choice("failure", lasting="ever"),
        Choice("drift", lasting="ever"),
    ],
)
def test_what_lasts_may_begin_after_a_pause_of_weeks(body: PccSimulator, choice: Choice) -> None:
    weeks_s = 21 * 24 * 3600.0
    space = Space(Hypothesis((choice,), ()), body, 4.0)
    begins = next(k for k, axis in enumerate(space.axes) if axis.name in MOMENTS)
    point = np.clip(np.array([axis.scaled(weeks_s) if k == begins else 0.0 for k, axis in enumerate(space.axes)]), *space.bounds)
    assert space.values(point)[begins] == pytest.approx(weeks_s)
    assert getattr(space.effects(point)[0], space.axes[begins].name) == pytest.approx(weeks_s)


def test_a_moment_within_a_pause_lies_between_the_runs_beside_it(body: PccSimulator) -> None:
    pause_s, choice = 3600.0, Choice("gain", 0, gate=Gate("since_s", 5.0), lasting="ever", before_gauge=True)
    sound, off = (made(body, acts, seed=3, sessions=4, measured=True).recordings
                  for acts in ((), (Gain(0.7, chamber=0, before_gauge=True),)))  # fmt: skip
    runs = [replace(r, session="week", time=r.time + k * pause_s) for k, r in enumerate((*sound[:2], *off[2:]))]
    problem = Problem(body.robot, body, tuple(in_order(runs)), configured().numerics, "pressure", "command", False, False)
    hypothesis = Hypothesis((choice,), ())
    axes = problem.space(hypothesis).axes
    wanted = {"gain": 0.7, "since_s": pause_s + 100.0, "over_s": 1.0}
    point = np.array([axis.scaled(wanted[axis.name]) for axis in axes])
    [trial] = fit_trials(problem, None, [(hypothesis, [point])], configured().search)
    column = [axis.name for axis in axes].index("since_s")
    low, high = (axes[column].physical(end) for end in _flat(problem, trial, column))
    assert pause_s + 10.0 < low < pause_s + np.ptp(runs[1].time) + 1.0
    assert 2.0 * pause_s <= high < 2.0 * pause_s + 10.0


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


def failed(
    body: PccSimulator, lasting: str, sessions: tuple[str, ...], share: float, noise_m: float = 0.0
) -> tuple[Problem, float]:
    """Return two days, without noise but what is asked for, with a chamber that fails after a share of the time, and when."""
    blank = in_order(days(body, Failure(0.0, 0.0), until="ever").recordings)
    clock, mine = ("", "session", "ever").index(lasting), [one for one in blank if not sessions or one.session in sessions]
    onset_s = share * max(one.gone_s[clock] + float(np.ptp(one.time)) for one in mine)
    found, rng = [], np.random.default_rng(0)
    for one in blank:
        failure = Failure(0.4, onset_s, chamber=1, begun_s=one.gone_s[clock])
        moved = replay(Plant(body, chain_of(body.robot, (failure,) if one in mine else ())), one, 0.01).position
        assert moved is not None
        found.append(replace(one, position=moved + noise_m * rng.standard_normal(moved.shape)))
    return Problem(body.robot, body, tuple(found), configured().numerics, "motion", "command", False, False), onset_s


FORMS = [("", ()), ("ever", ()), ("session", ("first",))]


@pytest.mark.parametrize(("lasting", "sessions"), FORMS)
@pytest.mark.parametrize("share", [0.1, 0.35, 0.9])
def test_where_something_begins_is_seen_before_anything_is_fitted(
    body: PccSimulator, lasting: str, sessions: tuple[str, ...], share: float
) -> None:
    """Beside retuned parameters that hide some of it; the moment told is within a piece of the true one."""
    problem, onset_s = failed(body, lasting, sessions, share)
    bare, search = Hypothesis((), tuple(body.parameters)), configured().search
    retuned = fit_trials(problem, None, [(bare, [np.zeros(len(bare.tuned))])], search)[0]
    choice = Choice("failure", 1, lasting=lasting, sessions=sessions)
    found = onsets(problem, bases_of(problem, retuned), [choice, Choice("drift")], search)
    assert list(found) == [choice]
    nearest = min(abs(values["onset_s"] - onset_s) for values in found[choice])
    assert nearest < 1.5 * onset_s / share / PIECES, (found, onset_s)


@pytest.mark.parametrize(("lasting", "sessions"), FORMS[1:])
@pytest.mark.parametrize("first_s", [10.0, 14.0, 30.0])
def test_no_run_is_asked_when_something_began_in_another(
    body: PccSimulator, lasting: str, sessions: tuple[str, ...], first_s: float
) -> None:
    """A law that leaves noise in every run leaves no more where one is left out, though that alone tells the moment."""
    problem, onset_s = failed(body, lasting, sessions, first_s / 75.0 / (2.0 if lasting == "ever" else 1.0), noise_m=1e-4)
    bare, config = Hypothesis((), tuple(body.parameters)), configured()
    retuned = fit_trials(problem, None, [(bare, [np.zeros(len(bare.tuned))])], config.search)[0]
    choice = Choice("failure", 1, lasting=lasting, sessions=sessions)
    lead = rank(problem, retuned, [choice], config.search)[0]
    assert lead.gain > 0.99
    trial = at_its_moment(problem, fit_leads(problem, retuned, [lead], config.search)[0], config.search)
    axis, column = axes_of(trial, choice)["onset_s"]
    right = trial.fit.point.copy()
    right[column] = axis.scaled(onset_s)
    assert trial.fit.cost < 1.2 * 0.5 * problem.residual(trial.hypothesis, right).squares.sum()
    told = {found.name: found for found in intervals(problem, trial, config.thresholds) if found.owner == choice.label()}
    assert told["loss"].low < 0.4 < told["loss"].high and told["loss"].high - told["loss"].low < 0.02, told


def test_one_run_tells_when_something_began_and_all_that_follow_how_a_drift_did(body: PccSimulator) -> None:
    for choice, once in (
        (Choice("failure", 1, lasting="ever"), ["onset_s"]),
        (Choice("leak", 1, gate=Gate("since_s", 5.0), lasting="ever"), ["over_s", "since_s"]),
        (Choice("failure", 1), []),
        (Choice("drift", lasting="ever"), []),
    ):
        space = Space(Hypothesis((choice,), tuple(body.parameters)), body, 4.0)
        assert sorted(axis.name for axis, one in zip(space.axes, space.told_once, strict=True) if one) == once
