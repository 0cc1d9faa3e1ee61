"""Sessions that were recorded in another frame than the others are placed by themselves, whether fitted or held out whole."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.diagnosis.checks.data import Data, prepare
from softrl.diagnosis.stage import _whole
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from tests.diagnosis.conftest import configured, made

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def placed_by_itself(body: PccSimulator, recordings: RecordingSet, change: Callable[[Recording], Recording]) -> dict[bool, bool]:
    """Return whether sessions are placed by themselves, by whether the one that is changed was held out whole."""
    found = {}
    for odd in recordings.sessions():
        runs = tuple(change(run) if run.session == odd else run for run in recordings.recordings)
        data = prepare(replace(recordings, recordings=runs), body.robot, 0.34, 0)
        assert isinstance(data, Data)
        held = odd not in {run.session for run in data.training}
        found[held] = _whole(configured(), body.robot, body, data, configured().numerics).register
    return found


def turned(run: Recording) -> Recording:
    return replace(run, position=np.asarray(run.position) @ QUARTER.T, quaternion=None)


def test_the_split_does_not_decide_whether_a_turned_session_is_noticed(body: PccSimulator) -> None:
    recordings = made(body, sessions=3)
    assert placed_by_itself(body, recordings, lambda run: run) == {True: False, False: False}
    assert placed_by_itself(body, recordings, turned) == {True: True, False: True}


@pytest.mark.parametrize(("name", "numbers"), [("payload", {"mass": 0.6}), ("gain", {"gain": 0.5, "chamber": 0})])
def test_physics_of_a_session_held_out_whole_is_no_frame(body: PccSimulator, name: str, numbers: dict[str, float]) -> None:
    recordings = made(body, sessions=3)
    other = {run.name: run for run in made(body, (effect_class(name)(**numbers),), sessions=3).recordings}
    assert placed_by_itself(body, recordings, lambda run: other[run.name]) == {True: False, False: False}
