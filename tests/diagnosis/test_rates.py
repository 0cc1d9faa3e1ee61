"""Logs of different rates, copies, and cameras that were moved are no physics."""

from dataclasses import replace

import numpy as np

from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.data import Data, prepare
from softrl.diagnosis.stage import run
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from tests.diagnosis.conftest import configured, made

FEW = {"candidates": ["delay", "dead_time", "lag", "gain"], "search": {"keep": 3}}


def from_its_row_on(recording: Recording) -> Recording:
    """Return the run as a log has it whose rows act from their time on."""
    command = recording.pressure_cmd
    return replace(recording, pressure_cmd=np.vstack([command[1:], command[-1:]]))


def test_rows_that_act_from_their_time_on_are_late_by_their_own_interval(body: PccSimulator) -> None:
    slow, quick = (made(body, seed=seed, sessions=3, period_s=period) for seed, period in ((1, 0.05), (2, 0.01)))
    runs = [replace(from_its_row_on(r), session="slow") for r in slow.recordings]
    runs += [replace(from_its_row_on(r), session="quick", name=f"quick_{r.name}") for r in quick.recordings]
    found = run(configured(**FEW), body.robot, RecordingSet(body.robot.name, tuple(runs)), body, tracker=NullTracker())
    assert found.verdict == "nothing missing", found.sentences


def test_a_copy_of_a_run_does_not_judge_it(body: PccSimulator) -> None:
    runs = made(body, sessions=3).recordings
    copied = RecordingSet(body.robot.name, (*runs, replace(runs[0], name="again", session="again")))
    data = prepare(copied, body.robot, 0.34, 0)
    assert isinstance(data, Data) and len(data.training) + len(data.heldout) == 3
    assert any("again" in line and "copy" in line for line in data.mended), data.mended


def test_travel_is_within_a_session(body: PccSimulator) -> None:
    runs = made(body, sessions=6).recordings
    at_home = [replace(r, session="a" if k < 3 else "b") for k, r in enumerate(runs)]
    moved = [replace(r, position=np.asarray(r.position) + 0.3 * (r.session == "b")) for r in at_home]
    travel = [prepare(RecordingSet(body.robot.name, tuple(rs)), body.robot, 0.34, 0) for rs in (at_home, moved)]
    assert all(isinstance(data, Data) for data in travel)
    np.testing.assert_allclose(travel[1].travel, travel[0].travel, rtol=1e-9)  # type: ignore[union-attr]


def test_of_every_session_of_three_runs_one_judges(body: PccSimulator) -> None:
    """What acted on one day only has to show where it is judged, though whole days are held out."""
    runs = [replace(r, session=f"day {k // 3}") for k, r in enumerate(made(body, sessions=9).recordings)]
    data = prepare(RecordingSet(body.robot.name, tuple(runs)), body.robot, 0.34, 0)
    assert isinstance(data, Data)
    fitted, judging = ([r.session for r in side] for side in (data.training, data.heldout))
    assert len(set(judging)) == 3 and all(fitted.count(s) == 2 for s in set(fitted)) and len(set(fitted)) == 2
