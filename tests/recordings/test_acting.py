"""When a row's command acts, as a dataset says it."""

from pathlib import Path

import numpy as np
import pytest

from softrl.core.errors import RecordingError
from softrl.recordings.acting import ACTS, FROM, UNTIL, is_known, until_rows
from softrl.recordings.read import read
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.write import write


def written(folder: Path, notes: dict[str, str | None]) -> Path:
    time = 0.1 * np.arange(4)
    pressure = np.outer([1e3, 2e3, 3e3, 4e3], [1.0, 2.0, 3.0])
    run = Recording("steps", "monday", time, pressure, position=np.tile([0.0, 0.0, 0.1], (4, 1)))
    write(folder, RecordingSet("robot", (run,), notes))
    return folder


def test_commands_that_act_from_their_row_on_stand_a_row_later(tmp_path: Path) -> None:
    found = read(written(tmp_path, {ACTS: FROM}), None)
    np.testing.assert_allclose(found.recordings[0].pressure_cmd[:, 0], [1e3, 1e3, 2e3, 3e3])
    assert found.notes[ACTS] == UNTIL and is_known(found), "told once, and shifted once"
    write(tmp_path / "again", found)
    again = read(tmp_path / "again", None)
    np.testing.assert_allclose(again.recordings[0].pressure_cmd, found.recordings[0].pressure_cmd)


@pytest.mark.parametrize(("notes", "known"), [({ACTS: UNTIL}, True), ({}, False), ({ACTS: None}, False)])
def test_else_commands_stay_where_they_are(tmp_path: Path, notes: dict[str, str | None], known: bool) -> None:
    found = read(written(tmp_path, notes), None)
    np.testing.assert_allclose(found.recordings[0].pressure_cmd[:, 0], [1e3, 2e3, 3e3, 4e3])
    assert is_known(found) == known


def test_anything_else_is_refused_with_what_is_expected(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"dataset.yaml: command_acts is 'late'; expected until_row or from_row"):
        read(written(tmp_path, {ACTS: "late"}), None)


@pytest.mark.parametrize(("wrong", "meant"), [("command_act", ACTS), ("session", "sessions"), ("disturb", "disturbed")])
def test_a_key_that_is_nearly_one_is_refused(tmp_path: Path, wrong: str, meant: str) -> None:
    with pytest.raises(RecordingError, match=rf"dataset.yaml: key '{wrong}' would be a note .*; did you mean {meant}\?"):
        read(written(tmp_path, {wrong: UNTIL}), None)


def test_a_note_of_any_other_name_is_kept(tmp_path: Path) -> None:
    assert read(written(tmp_path, {"source": "bench 3", "robots_head": "blue"}), None).notes["source"] == "bench 3"


@pytest.mark.parametrize(
    ("said", "rows", "known", "later", "told"),
    [
        (FROM, 1, True, 1, ""),
        (FROM, 0, False, 0, "shows 100% of its command's steps at their own row: taken as not known"),
        (FROM, -1, False, -1, "shows 100% of its command's steps a row before their own: taken as written a row late"),
        (UNTIL, 0, True, 0, ""),
        (UNTIL, -1, False, -1, "a row before their own"),
        (None, -1, False, -1, "a row before their own"),
        (None, 0, False, 0, ""),
    ],
)
def test_a_gauge_that_shows_steps_before_they_act_is_believed(
    tmp_path: Path, said: str | None, rows: int, known: bool, later: int, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    """What acts from a row on is seen at the next one: a gauge that follows at once says that it acted until then."""
    rng = np.random.default_rng(3)
    command = np.repeat(rng.uniform(0.0, 5e4, (12, 3)), 9, axis=0)
    number = np.arange(len(command))
    measured = command[np.clip(number - rows, 0, len(command) - 1)] + rng.normal(0.0, 100.0, command.shape)
    run = Recording(
        "steps", "monday", 0.02 * number, command, pressure_meas=measured, position=np.tile([0.0, 0.0, 0.1], (len(command), 1))
    )
    write(tmp_path, RecordingSet("robot", (run,), {ACTS: said}))
    found = read(tmp_path, None)
    assert is_known(found) is known
    assert told in caplog.text if told else not caplog.text
    np.testing.assert_allclose(found.recordings[0].pressure_cmd[20], command[20 - later])


def held(kind: str, hold: int, rng: np.random.Generator) -> np.ndarray:
    """Return commands (rows,) Pa, each held for ``hold`` rows."""
    k = np.arange(120)
    levels = {
        "sine": 0.5 - 0.5 * np.cos(2.0 * np.pi * k / 40.0),
        "stairs": (k % 9) / 8.0,
        "there and back": 1.0 - np.abs((k % 16) / 8.0 - 1.0),
        "squares": k % 2.0,
        "random": rng.uniform(0.0, 1.0, len(k)),
    }
    return np.repeat(1e5 * levels[kind], hold)


@pytest.mark.parametrize("said", [UNTIL, FROM, None])
@pytest.mark.parametrize(("hold", "period_s"), [(3, 0.5), (5, 0.02), (10, 0.02)])
@pytest.mark.parametrize("kind", ["sine", "stairs", "there and back", "squares", "random"])
def test_gauges_behind_slow_valves_shift_no_rows(said: str | None, hold: int, period_s: float, kind: str) -> None:
    """What a gauge still does of the step before is no answer to the next one; a row that is late shows all the same."""
    rng = np.random.default_rng(4)
    acts = held(kind, hold, rng)
    time, late = period_s * np.arange(1, len(acts) + 1), np.r_[acts[:1], acts[:-1]]
    told = np.r_[acts[1:], acts[-1:]] if said == FROM else acts
    for lag_rows in (0.5, 1.0, 2.0, 5.0, 15.0):
        seen, past = np.zeros(len(acts)), 0.0
        for k, wanted in enumerate(acts):
            seen[k] = past = wanted + (past - wanted) * np.exp(-1.0 / lag_rows)
        seen += rng.normal(0.0, 300.0, len(seen))
        true, wrong = (
            until_rows(RecordingSet("robot", (Recording("a", "s", time, written[:, None], seen[:, None]),), {ACTS: said}))
            for written in (told, late)
        )
        assert np.array_equal(true.recordings[0].pressure_cmd[1:-1, 0], acts[1:-1]) and is_known(true) is (said is not None)
        if lag_rows <= 2.0 and period_s * hold >= 0.2:
            assert np.array_equal(wrong.recordings[0].pressure_cmd[1:-1, 0], acts[1:-1]) and not is_known(wrong)
