"""Times that count from 1970 are read, kept and replayed as exactly as any others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrl.core.errors import RecordingError
from softrl.effects.chain import Plant, chain_of
from softrl.effects.replay import replay
from softrl.recordings.gone import in_order
from softrl.recordings.read import read
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.write import write
from tests.effects.test_replay import ROBOT, Wire

NOW_S = 1_764_000_000.25


def blank(name: str, session: str, first_s: float) -> Recording:
    time = first_s + 0.01 * np.arange(3000)
    return Recording(
        name, session, time, 1e4 * np.ones((len(time), 3)), position=np.tile([0.0, 0.0, 0.2], (len(time), 1))
    )


def test_a_sessions_times_count_from_its_first_sample(tmp_path: Path) -> None:
    monday = [blank(f"run_{k}", "monday", NOW_S + 100.0 * k) for k in range(3)]
    tuesday = [
        blank("clock", "tuesday", NOW_S + 1e5),
        blank("plain", "tuesday", 0.01),
        blank("later", "tuesday", 500.0),
    ]
    write(tmp_path / "set", RecordingSet("wire", (*monday, *tuesday)))
    found = read(tmp_path / "set", None)
    begins = {run.name: run.time[0] for run in found.recordings}
    expected = {"run_0": 0.0, "run_1": 100.0, "run_2": 200.0, "clock": 0.0, "plain": 0.01, "later": 500.0}
    assert begins == pytest.approx(expected, abs=1e-4)
    for run in found.recordings:
        np.testing.assert_allclose(run.time - run.time[0], 0.01 * np.arange(3000), atol=2e-5)
    assert [run.gone_s[1] for run in in_order(found.recordings)][:3] == pytest.approx([0.0, 100.0, 200.0], abs=1e-4)
    write(tmp_path / "again", found)
    for once, twice in zip(found.recordings, read(tmp_path / "again", None).recordings, strict=True):
        np.testing.assert_allclose(twice.time, once.time, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("begins", "refused"),
    [
        ((200.0, 0.0, 100.0), "run 'run_1' begins 229.99 s before the end of run 'run_0'"),
        ((0.0, 100.0, 105.0), "run 'run_2' begins 24.99 s before the end of run 'run_1'"),
        ((0.0, 29.99, 100.0), ""),  # one file goes on with the last row of another
    ],
)
def test_runs_that_their_clock_puts_in_another_order_are_refused(
    begins: tuple[float, ...], refused: str, tmp_path: Path
) -> None:
    runs = tuple(blank(f"run_{k}", "monday", NOW_S + begin) for k, begin in enumerate(begins))
    write(tmp_path, RecordingSet("wire", runs))
    if not refused:
        assert len(read(tmp_path, None).recordings) == 3
        return
    with pytest.raises(RecordingError, match=rf"session 'monday': {refused}, .* list runs in the order of recording") as told:
        read(tmp_path, None)
    assert "\n" not in str(told.value)


def test_sessions_that_their_clocks_put_in_another_order_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    days = {"friday": 4 * 86400.0, "monday": 0.0, "tuesday": 86400.0}
    write(tmp_path, RecordingSet("wire", tuple(blank(f"{day}_run", day, NOW_S + begin) for day, begin in days.items())))
    assert read(tmp_path, None).sessions() == list(days), "a clock may have been set back: the list counts"
    assert "session 'monday' begins 345630 s before the end of session 'friday'" in caplog.text
    assert "session 'tuesday'" not in caplog.text and "list sessions in the order of recording" in caplog.text


def test_a_replay_is_not_late_however_large_its_times() -> None:
    time = 0.02 * np.arange(15000)
    command = 1e4 + 1e4 * np.sin(np.outer(time, [1.0, 0.7, 0.4]))
    small = Recording("run", "day", time, command)
    plant = Plant(Wire(ROBOT), chain_of(ROBOT, ()))
    one, other = (replay(plant, run, 0.005) for run in (small, replace(small, time=NOW_S + time)))
    np.testing.assert_allclose(other.position, one.position, atol=5.0)  # 1 ms is 10 Pa
