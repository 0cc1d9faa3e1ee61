"""Times that count from 1970 are read, kept and replayed as exactly as any others."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

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


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_a_sessions_times_count_from_its_first_sample(order: tuple[int, ...], tmp_path: Path) -> None:
    monday = [blank(f"run_{k}", "monday", NOW_S + 100.0 * k) for k in range(3)]
    tuesday = [
        blank("clock", "tuesday", NOW_S + 1e5),
        blank("plain", "tuesday", 0.01),
        blank("later", "tuesday", 500.0),
    ]
    write(tmp_path / "set", RecordingSet("wire", (*(monday[k] for k in order), *tuesday)))
    found = read(tmp_path / "set", None)
    begins = {run.name: run.time[0] for run in found.recordings}
    expected = {"run_0": 0.0, "run_1": 100.0, "run_2": 200.0, "clock": 0.0, "plain": 0.01, "later": 500.0}
    assert begins == pytest.approx(expected, abs=1e-4)
    for run in found.recordings:
        np.testing.assert_allclose(run.time - run.time[0], 0.01 * np.arange(3000), atol=2e-5)
    if order == (0, 1, 2):
        assert [run.gone_s[1] for run in in_order(found.recordings)][:3] == pytest.approx([0.0, 100.0, 200.0], abs=1e-4)
    write(tmp_path / "again", found)
    for once, twice in zip(found.recordings, read(tmp_path / "again", None).recordings, strict=True):
        np.testing.assert_allclose(twice.time, once.time, rtol=0.0, atol=1e-12)


def test_a_replay_is_not_late_however_large_its_times() -> None:
    time = 0.02 * np.arange(15000)
    command = 1e4 + 1e4 * np.sin(np.outer(time, [1.0, 0.7, 0.4]))
    small = Recording("run", "day", time, command)
    plant = Plant(Wire(ROBOT), chain_of(ROBOT, ()))
    one, other = (replay(plant, run, 0.005) for run in (small, replace(small, time=NOW_S + time)))
    np.testing.assert_allclose(other.position, one.position, atol=5.0)  # 1 ms is 10 Pa
