"""Runs that a dataset's notes set apart are left out, by their own name or their session's."""

import numpy as np
import pytest

from softrl.recordings.marked import DISTURBED, OUTSIDE, without
from softrl.recordings.recording import Recording, RecordingSet


@pytest.mark.parametrize(
    ("notes", "left"),
    [
        ({}, ["a", "b", "c"]),
        ({"disturbed": ["b"]}, ["a", "c"]),
        ({"disturbed": ["monday"]}, ["c"]),
        ({"disturbed": ["a"], "out_of_distribution": ["tuesday"]}, ["b"]),
        ({"disturbed": "a"}, ["b", "c"]),
        ({"disturbed": None, "comment": "c"}, ["a", "b", "c"]),
    ],
)
def test_marked_runs_are_left_out(notes: dict[str, object], left: list[str]) -> None:
    runs = (("a", "monday"), ("b", "monday"), ("c", "tuesday"))
    made = tuple(Recording(name, session, np.arange(2.0), np.zeros((2, 3))) for name, session in runs)
    found = without(RecordingSet("tripod", made, notes), DISTURBED, OUTSIDE)
    assert [run.name for run in found.recordings] == left
    assert found.notes == notes
