"""Laws of the split: whole groups, nothing lost, nothing on both sides, drawn by the seed alone."""

import numpy as np
import pytest

from softrl.core.errors import RecordingError
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.split import split


def example(sessions: list[str]) -> RecordingSet:
    time = np.array([0.0, 0.1])
    return RecordingSet("r", tuple(Recording(f"run{k}", s, time, np.zeros((2, 1))) for k, s in enumerate(sessions)))


@pytest.mark.parametrize("seed", range(5))
def test_sessions_stay_whole(seed: int) -> None:
    train, heldout = split(example(["a", "a", "b", "c", "c", "d"]), 0.5, seed)
    assert set(train.sessions()) | set(heldout.sessions()) == {"a", "b", "c", "d"}
    assert not set(train.sessions()) & set(heldout.sessions())
    assert len(train.recordings) + len(heldout.recordings) == 6
    assert len(heldout.sessions()) == 2


def test_one_session_is_split_by_run() -> None:
    train, heldout = split(example(["a"] * 4), 0.25, seed=1)
    assert (len(train.recordings), len(heldout.recordings)) == (3, 1)


def test_same_seed_same_split() -> None:
    data = example(["a"] * 8)
    names = [[r.name for r in split(data, 0.5, seed)[1].recordings] for seed in (1, 1, 2, 3, 4)]
    assert names[0] == names[1] and any(n != names[0] for n in names[2:])


def test_one_run_cannot_be_split() -> None:
    with pytest.raises(RecordingError, match="one run"):
        split(example(["a"]), 0.5, seed=1)
