"""Fits see as much of the recordings as they may, however long those are."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.data import Data, Refusal, prepare
from softrl.diagnosis.checks.gaps import rows
from softrl.diagnosis.checks.within import within
from softrl.diagnosis.stage import run
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured, made


def resting(name: str, length_s: float) -> Recording:
    time = np.arange(0.0, length_s + 0.05, 0.1)
    return Recording(name, "day", time, np.zeros((len(time), 3)))


@pytest.mark.parametrize("lengths", [(60.0, 60.0, 60.0), (20.0, 14400.0, 100.0), (14400.0, 14400.0, 14400.0), (10.0, 30.0)])
def test_cut_runs_fill_the_time_that_fits_may_take(lengths: tuple[float, ...]) -> None:
    runs = [resting(f"run_{k}", length) for k, length in enumerate(lengths)]
    cut = [float(np.ptp(run.time)) for run in within(runs, 75.0)]
    assert sum(cut) == pytest.approx(min(75.0, sum(lengths)), abs=0.1 * len(runs))
    assert all(length in (whole, max(cut)) for length, whole in zip(np.round(cut, 6), lengths, strict=True))


@pytest.mark.parametrize("seconds", [50.0, 300.0])
def test_each_run_counts_by_how_slow_its_own_rows_are(seconds: float) -> None:
    """A table of poses among logs of 0.1 s keeps as many rows as if all were tables, and so do these as if all were logs."""
    poses = [Recording(f"poses_{k}", f"slow_{k}", 30.0 * np.arange(60), np.zeros((60, 3))) for k in range(3)]
    logs = [resting(f"run_{k}", 295.0) for k in range(3)]
    alone = [run for some in (poses, logs) for run in within([*some, *some], seconds)[:3]]
    for order in ([*poses, *logs], [*logs, *poses]):
        found = {run.name: len(run.time) for run in within(order, seconds)}
        assert found == {run.name: len(run.time) for run in alone if run.name in found} and len(found) >= 3
    whole = within(poses, 3 * 59 * 5.0)
    assert [len(run.time) for run in whole] == [60, 60, 60]


def test_a_run_that_is_too_short_is_told(body: PccSimulator) -> None:
    whole = made(body, (), sessions=3)
    first, *others = whole.recordings
    short = rows(first, first.time - first.time[0] < 2.5)
    data = prepare(replace(whole, recordings=(short, *others)), body.robot, 0.34, 0)
    assert isinstance(data, Data)
    assert any(line.startswith(f"{first.name}: 2.") and "left out" in line for line in data.mended)
    assert not prepare(whole, body.robot, 0.34, 0).mended


def test_a_run_in_which_no_command_changes_judges_nothing(body: PccSimulator) -> None:
    whole = made(body, sessions=3)
    runs = list(whole.recordings)
    still = [replace(run, pressure_cmd=np.zeros_like(run.pressure_cmd)) for run in runs]
    for k in range(3):
        found = prepare(replace(whole, recordings=(*runs[:k], still[k], *runs[k + 1 :])), body.robot, 0.34, 0)
        assert isinstance(found, Data) and found.heldout
        assert runs[k].name not in {run.name for run in found.heldout}
    refused = prepare(replace(whole, recordings=(runs[0], *still[1:])), body.robot, 0.34, 0)
    assert isinstance(refused, Refusal) and "commands change in 1 of 3 runs only" in refused.reason


def test_clocks_go_on_to_the_end_of_the_last_run_however_little_fits_see(body: PccSimulator) -> None:
    whole = made(body, sessions=3)
    last = whole.recordings[-1]
    found = prepare(replace(whole, notes={"out_of_distribution": [last.name]}), body.robot, 0.34, 0)
    assert isinstance(found, Data)
    took = sum(float(np.ptp(run.time)) for run in whole.recordings)
    assert found.shortened(5.0).now.gone_s[-1] == pytest.approx(took)


def test_what_acts_from_a_session_on_goes_on_in_one_that_fits_know_nothing_of(body: PccSimulator) -> None:
    """Its form lists the sessions that fits know: recorded behind the last of them, a run without its own session is as of it."""
    whole = made(body, sessions=4)
    first, second, third, last = whole.recordings
    for mark in ("out_of_distribution", "disturbed"):
        found = prepare(replace(whole, notes={mark: [last.name]}), body.robot, 0.34, 0)
        assert isinstance(found, Data) and found.now.session == third.session
        assert [run.session for run in found.outside] == ([third.session] if mark == "out_of_distribution" else [])
    between = prepare(replace(whole, notes={"out_of_distribution": [second.name]}), body.robot, 0.34, 0)
    assert isinstance(between, Data) and between.now.session == last.session
    assert [run.session for run in between.outside] == [first.session]


def test_runs_that_are_left_out_say_nothing_about_frames_and_orientations(body: PccSimulator) -> None:
    whole = made(body, sessions=4)
    *others, last = whole.recordings
    elsewhere = replace(last, position=np.asarray(last.position) + 3.0 * body.robot.length_m)
    for notes, misplaced in (({}, True), ({"disturbed": [last.name]}, False), ({"out_of_distribution": [last.name]}, False)):
        found = prepare(replace(whole, recordings=(*others, elsewhere), notes=notes), body.robot, 0.34, 0)
        assert isinstance(found, Data) and found.misplaced is misplaced and len(found.check.runs) == 4


def test_a_coarse_sensor_is_as_wrong_as_its_last_digit(body: PccSimulator) -> None:
    whole = made(body, sessions=3, noise_m=1e-9)
    coarse = replace(whole, recordings=tuple(replace(r, position=np.round(np.asarray(r.position), 3)) for r in whole.recordings))
    found = prepare(coarse, body.robot, 0.34, 0)
    assert isinstance(found, Data) and found.noise == found.rounding == pytest.approx(1e-3 / 2.0)
    loud = made(body, sessions=3, noise_m=1e-3)
    blurred = replace(loud, recordings=tuple(replace(r, position=np.round(np.asarray(r.position), 3)) for r in loud.recordings))
    found = prepare(blurred, body.robot, 0.34, 0)
    assert isinstance(found, Data) and found.rounding == 0.0 and found.noise > 1e-3


def test_the_noise_of_an_orientation_is_that_of_its_turns(body: PccSimulator) -> None:
    """Of 0.3 mrad about each axis, also where the body still swings at the ends of its holds."""
    data = prepare(made(body, sessions=4), body.robot, 0.34, 0)
    assert isinstance(data, Data) and data.turn_noise == pytest.approx(np.sqrt(3.0) * 3e-4, rel=0.1)


def test_a_sample_that_tracking_mistook_is_no_noise_between_repeats(body: PccSimulator) -> None:
    whole, rng = made(body, sessions=4, noise_m=0.0), np.random.default_rng(5)
    runs = [
        replace(whole.recordings[k // 2], name=f"run_{k}", session=f"day_{k // 2}") for k in range(4)
    ]  # two of equal commands a day
    runs = [replace(run, position=np.asarray(run.position) + 1e-4 * rng.standard_normal((len(run.time), 3))) for run in runs]
    for mistaken in ([], [(0, 700)], [(0, 700), (1, 300), (3, 500)]):
        for k, row in mistaken:
            position = np.array(runs[k].position)
            position[row] += 0.05
            runs[k] = replace(runs[k], position=position)
        data = prepare(replace(whole, recordings=tuple(runs)), body.robot, 0.34, 0)
        assert isinstance(data, Data) and len(data.mended) == len(mistaken)
        assert data.noise == pytest.approx(np.sqrt(3.0) * 1e-4, rel=0.1), mistaken


def test_a_run_of_two_rows_tells_no_noise(body: PccSimulator) -> None:
    whole = made(body, sessions=3)
    first = whole.recordings[0]
    torn = replace(rows(first, np.isin(np.arange(len(first.time)), (0, 300))), name="torn")
    sets = (replace(whole, recordings=(*whole.recordings, *more)) for more in ([torn], []))
    found, plain = (prepare(recordings, body.robot, 0.34, 0) for recordings in sets)
    assert isinstance(plain, Data) and isinstance(found, Data) and found.noise == pytest.approx(plain.noise, rel=0.1)


def test_runs_of_two_rows_alone_are_refused_and_may_join_others(body: PccSimulator) -> None:
    whole = made(body, sessions=3)
    pairs = tuple(rows(run, np.array([0, 300])) for run in whole.recordings)
    found = prepare(replace(whole, recordings=pairs), body.robot, 0.34, 0)
    assert isinstance(found, Refusal) and "no run has 3 rows or more" in found.reason
    third = rows(whole.recordings[0], np.array([0, 500, 1000]))
    assert isinstance(prepare(replace(whole, recordings=(third, *pairs[1:])), body.robot, 0.34, 0), Data | Refusal)


def test_where_every_run_is_marked_that_is_the_reason(body: PccSimulator) -> None:
    whole = made(body, sessions=3)
    for mark in ("disturbed", "out_of_distribution"):
        refused = prepare(replace(whole, notes={mark: [run.name for run in whole.recordings]}), body.robot, 0.34, 0)
        assert isinstance(refused, Refusal) and "is marked as disturbed or out of distribution" in refused.reason


@pytest.mark.parametrize("noise_pa", [0.0, 100.0])
def test_gauges_that_are_all_dead_are_left_out(noise_pa: float, body: PccSimulator) -> None:
    whole, rng = made(body, sessions=3, measured=True), np.random.default_rng(0)
    dead = [replace(run, pressure_meas=noise_pa * rng.standard_normal(run.pressure_cmd.shape)) for run in whole.recordings]
    found = prepare(replace(whole, recordings=tuple(dead)), body.robot, 0.34, 0)
    assert isinstance(found, Data) and not found.pressure and any("dead, and left out" in line for line in found.mended)
    scaled = [replace(run, pressure_meas=1e-3 * np.asarray(run.pressure_meas)) for run in whole.recordings]
    refused = prepare(replace(whole, recordings=tuple(scaled)), body.robot, 0.34, 0)
    assert isinstance(refused, Refusal) and "a wrong unit" in refused.reason


def test_what_cannot_tell_says_why_runs_were_left_out(body: PccSimulator, caplog: pytest.LogCaptureFixture) -> None:
    """The same file twice, and a run of two seconds: one run is left, and it is told where the others went."""
    whole = made(body, sessions=2)
    first, second = whole.recordings
    copy, short = replace(first, name="b"), rows(second, second.time < second.time[0] + 2.0)
    for recordings in ((first, copy, short), (first, copy, replace(second, pressure_cmd=np.zeros_like(second.pressure_cmd)))):
        caplog.clear()
        told = run(configured(), body.robot, replace(whole, recordings=recordings), body, tracker=NullTracker())
        assert told.verdict == "unknown" and told.sentences[0].startswith("Cannot tell")
        lines = [line for line in told.data["warnings"] if "left out" in line]
        assert any(line.startswith("b: measured the same as") for line in lines)
        assert any(line.startswith(f"{short.name}: 2 s") for line in lines) == (recordings[-1] is short)
        assert all(line in caplog.text for line in lines)
