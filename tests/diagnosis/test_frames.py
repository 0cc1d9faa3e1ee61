"""Sessions that were recorded in another frame than the others are placed by themselves, whether fitted or held out whole."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.core.config import build
from softrl.diagnosis.checks.data import Data, prepare
from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.judging.correct import model_of, traces
from softrl.diagnosis.stage import _whole
from softrl.effects.library import effect_class
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, made, node

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def placed_by_itself(body: PccSimulator, recordings: RecordingSet, change: Callable[[Recording], Recording]) -> dict[bool, bool]:
    """Return whether sessions are placed by themselves, by whether the one that is changed was held out whole."""
    found = {}
    for odd in recordings.sessions():
        runs = tuple(change(run) if run.session == odd else run for run in recordings.recordings)
        data = prepare(replace(recordings, recordings=runs), body.robot, 0.34, 0)
        assert isinstance(data, Data)
        held = odd not in {run.session for run in data.training}
        found[held] = _whole(configured(), body.robot, body, data, configured().numerics)[0].register
    return found


def test_a_soft_robot_that_lies_rests_where_it_sags() -> None:
    """No origin is wrong where the tip hangs as far aside as the simulator has it; one that was moved is."""
    segment = build(node("robot/three_chamber_segment.yaml"), Robot, "robot")
    lying = replace(segment, gravity_m_s2=(9.81, 0.0, 0.0), mass_kg=0.3, chamber_area_m2=2e-5)
    body = PccSimulator(robot=lying, **node("simulator/pcc.yaml"))
    recordings = made(body, sessions=3)
    for moved, told in ((np.zeros(3), False), (np.array([0.1, 0.0, 0.0]), True)):
        runs = tuple(replace(run, position=np.asarray(run.position) + moved) for run in recordings.recordings)
        data = prepare(replace(recordings, recordings=runs), lying, 0.34, 0)
        assert isinstance(data, Data) and data.misplaced
        whole, data = _whole(configured(), lying, body, data, configured().numerics)
        assert whole.register is data.misplaced is told
        assert any("under no pressure the tip" in line for line in data.check.warnings) is told


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


def at_rest(body: PccSimulator, like: Recording, name: str, session: str, seed: int) -> Recording:
    """Return what the tip of a body shows that nobody drives, in noise."""
    noise = 1e-4 * np.random.default_rng(seed).standard_normal((len(like.time), 3))
    tip = body.observe(body.reset())[0]
    return Recording(name, session, like.time, np.zeros_like(like.pressure_cmd), position=tip + noise)


@pytest.mark.parametrize(("name", "numbers"), [("payload", {"mass": 0.3}), ("gain", {"gain": 0.7})])
def test_a_session_at_rest_is_turned_by_nothing(body: PccSimulator, name: str, numbers: dict[str, float]) -> None:
    """What the others lack moves their common frame a little, and its noise fits at any turn."""
    whole = made(body, (effect_class(name)(**numbers),), sessions=3)
    rest = at_rest(body, whole.recordings[0], "rest", "rest_day", 8)
    data = prepare(replace(whole, recordings=(*whole.recordings, rest)), body.robot, 0.34, 0)
    assert isinstance(data, Data) and "rest" in {run.name for run in data.training}
    assert not _whole(configured(), body.robot, body, data, configured().numerics)[0].register


@pytest.mark.parametrize("seed", [0, 1])
def test_a_session_held_out_whole_is_placed_by_its_motion_and_not_by_a_run_at_rest(body: PccSimulator, seed: int) -> None:
    whole = made(body, sessions=3)
    pairs = [(run, at_rest(body, run, f"rest_{k}", run.session, k)) for k, run in enumerate(whole.recordings)]
    runs = tuple(turned(run) if k == 2 * seed else run for k, pair in enumerate(pairs) for run in pair)
    data = prepare(replace(whole, recordings=runs), body.robot, 0.34, seed)
    assert isinstance(data, Data)
    assert not {run.session for run in data.heldout} & {run.session for run in data.training}
    problem = _whole(configured(), body.robot, body, data, configured().numerics)[0]
    assert problem.register
    model = model_of(problem.on(data.training), Hypothesis((), ()), np.zeros(0))
    assert traces(problem.on(data.heldout), model).rms < 2.0 * np.sqrt(3.0) * 1e-4
