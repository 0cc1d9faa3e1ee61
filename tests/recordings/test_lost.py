"""A frame that the camera lost: its row's command acts, its motion is not compared, and nothing is made up of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrl.core.errors import RecordingError
from softrl.diagnosis.checks.gaps import mend
from softrl.diagnosis.checks.within import within
from softrl.diagnosis.fitting.bins import Bins
from softrl.recordings.lost import lost
from softrl.recordings.read import read
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.write import write
from tests.recordings.test_format import robot_named

HEAD = "time_s,p1_cmd_kpa,p2_cmd_kpa,p3_cmd_kpa,tip_x_mm,tip_y_mm,tip_z_mm\n"


def folder_with(folder: Path, rows: list[str]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "dataset.yaml").write_text("robot: tripod\n")
    (folder / "run.csv").write_text(HEAD + "\n".join(rows) + "\n")
    return folder


def rows_of(lost_as: str, at: tuple[int, ...] = (2, 3), count: int = 10) -> list[str]:
    seen = [f"{0.1 * k:.1f},{k},0,0," + (lost_as if k in at else f"{2 * k},0,{176 + k}") for k in range(count)]
    return seen


@pytest.mark.parametrize("lost_as", ["nan,nan,nan", ",,", "7,nan,176"])
def test_lost_motion_is_bridged_and_marked(tmp_path: Path, lost_as: str) -> None:
    (run,) = read(folder_with(tmp_path, rows_of(lost_as)), robot_named("tripod")).recordings
    assert run.unseen is not None and run.position is not None
    np.testing.assert_array_equal(np.flatnonzero(run.unseen), [2, 3])
    np.testing.assert_allclose(run.position[:, 0], 2e-3 * np.arange(10), atol=1e-12)
    np.testing.assert_allclose(run.pressure_cmd[:, 0], 1e3 * np.arange(10))


@pytest.mark.parametrize("order", [(4, 5, 6, 0, 1, 2, 3), (4, 0, 1, 2, 3, 5, 6), (0, 1, 2, 3, 4, 5, 6)])
def test_columns_of_motion_may_be_empty_wherever_they_stand(tmp_path: Path, order: tuple[int, ...]) -> None:
    """One empty cell at the begin of a line stands between no two commas."""
    rows = [f"{0.1 * k:.1f},{k},0,0,{'' if k in (2, 3) else 2 * k},0,{176 + k}" for k in range(10)]
    folder_with(tmp_path, rows)
    lines = [line.split(",") for line in (tmp_path / "run.csv").read_text().splitlines()]
    (tmp_path / "run.csv").write_text("\n".join(",".join(cells[k] for k in order) for cells in lines) + "\n")
    (run,) = read(tmp_path, robot_named("tripod")).recordings
    assert run.unseen is not None
    np.testing.assert_array_equal(np.flatnonzero(run.unseen), [2, 3])


def test_lost_motion_is_written_as_such_and_read_back(tmp_path: Path) -> None:
    found = read(folder_with(tmp_path / "a", rows_of("nan,nan,nan")), robot_named("tripod"))
    write(tmp_path / "b", found, robot_named("tripod"))
    assert (tmp_path / "b" / "run.csv").read_text().count("nan") == 6
    (run,), (again,) = found.recordings, read(tmp_path / "b", robot_named("tripod")).recordings
    assert run.position is not None and again.position is not None and again.unseen is not None
    np.testing.assert_array_equal(run.unseen, again.unseen)
    np.testing.assert_allclose(run.position, again.position, atol=1e-9)


def test_a_run_without_most_of_its_motion_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="nan where motion was lost, in half of a run's rows at most"):
        read(folder_with(tmp_path, rows_of("nan,nan,nan", at=tuple(range(2, 9)))), robot_named("tripod"))


def test_bins_hold_what_was_seen_only() -> None:
    time, unseen = 0.02 * np.arange(10), np.isin(np.arange(10), [1, 5, 6, 7, 8, 9])
    bins = Bins(time, 0, 0.1, ~unseen)
    np.testing.assert_array_equal(bins.places, [0])
    np.testing.assert_allclose(bins.mean(np.arange(10.0)[:, None]), [[(0 + 2 + 3 + 4) / 4]])
    assert bins.noise_left == pytest.approx(0.25)
    assert len(bins.number) == 10


def test_parts_of_a_run_know_what_was_lost_in_them() -> None:
    time = 0.1 * np.arange(6)
    turned = np.stack([np.cos(time), np.sin(time), 0 * time, 0 * time], axis=1)
    run = Recording("run", "day", time, np.zeros((6, 3)), quaternion=turned, bend_angle=time.copy())
    marked = lost(lost(run, np.arange(6) == 2), np.arange(6) == 4)
    part = marked.part(slice(2, 6))
    np.testing.assert_array_equal(part["unseen"], [True, False, True, False])
    assert marked.quaternion is not None
    np.testing.assert_allclose(marked.quaternion, turned, atol=1e-3)
    assert RecordingSet("tripod", (marked,)).sessions() == ["day"]


def test_fits_see_no_piece_of_a_run_whose_motion_was_lost() -> None:
    time = 0.1 * np.arange(600)
    moved = np.outer(np.sin(time), [0.01, 0.0, 0.0])
    whole = Recording("whole", "day", time, np.ones((600, 3)) * moved[:, :1], position=moved)
    blind = lost(replace(whole, name="blind"), time < 25.0)
    assert [run.name for run in within([whole, blind], 40.0)] == ["whole"]
    assert [run.name for run in within([whole, blind], 200.0)] == ["whole", "blind"]
    torn = replace(blind, time=blind.time + 30.0 * (blind.time >= 20.0))
    assert [part.name for part in mend(torn, [(19.9, 30.1)]).parts] == ["blind, part 2"]
