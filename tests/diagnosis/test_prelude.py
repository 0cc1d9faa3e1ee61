"""What a run was under before its first sample is read from where it was first seen."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.prelude import preludes
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.problem import Numerics, Problem
from softrl.diagnosis.stage import run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.lag import Lag
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, made, node

LAG_S = 0.6


SENT_OFF, MIDWAY = 105, 215  # rows: the first command has just been given; the second step is on its way
CHANNELS = ("time", "pressure_cmd", "position", "quaternion")


def from_row(first: int) -> Callable[[Recording], Recording]:
    """Return what leaves out the rows of a run before ``first``."""

    def process(recording: Recording) -> Recording:
        return replace(recording, **{name: getattr(recording, name)[first:] for name in CHANNELS})

    return process


def lagging(body: PccSimulator, first: int, sessions: int) -> RecordingSet:
    """Return runs of a body behind a slow valve, from row ``first`` on, without their measured pressures."""
    whole = made(body, (Lag(fill_s=LAG_S, vent_s=LAG_S),), sessions=sessions)
    cut = from_row(first)
    return replace(
        whole, recordings=tuple(cut(replace(r, pressure_meas=None, bend_angle=None)) for r in whole.recordings)
    )


def test_a_run_sent_off_from_rest_began_under_no_pressure(body: PccSimulator) -> None:
    runs = lagging(body, SENT_OFF, 3).recordings
    assert all(np.linalg.norm(recording.pressure_cmd[0]) > 5e3 for recording in runs)
    same = [replace(recording, session="day") for recording in runs]
    found = preludes(same, same, body.robot)
    for recording in runs:
        assert np.linalg.norm(found[recording.name]) < 0.3 * np.linalg.norm(recording.pressure_cmd[0])


def test_a_run_of_a_session_held_out_whole_began_where_all_training_runs_tell(body: PccSimulator) -> None:
    runs = lagging(body, SENT_OFF, 4).recordings
    training, heldout = [replace(r, session=f"day_{k}") for k, r in enumerate(runs[:-1])], replace(runs[-1], session="other")
    assert heldout.name not in preludes(training, (heldout,), body.robot)
    found = preludes(training, (heldout,), body.robot, one_frame=True)[heldout.name]
    assert np.linalg.norm(found) < 0.3 * np.linalg.norm(heldout.pressure_cmd[0])


def test_a_tip_at_rest_that_something_pulled_aside_in_a_session_held_out_whole_is_not_under_way(body: PccSimulator) -> None:
    runs = lagging(body, 0, 3).recordings
    aside = replace(runs[-1], session="other", position=np.asarray(runs[-1].position) + np.array([0.03, 0.0, 0.0]))
    found = preludes(runs[:-1], (aside,), body.robot, one_frame=True)[aside.name]
    assert found == pytest.approx(np.zeros(3))


def test_a_robot_that_reports_an_angle_began_where_that_tells_though_some_runs_saw_the_tip_too() -> None:
    finger = build(node("robot/single_chamber_finger.yaml"), Robot, "robot")
    body, cut = PccSimulator(robot=finger, **node("simulator/pcc.yaml")), from_row(SENT_OFF)
    whole = made(body, (Lag(fill_s=LAG_S, vent_s=LAG_S),), sessions=3).recordings
    runs = [
        replace(cut(run), session="day", pressure_meas=None, bend_angle=np.asarray(run.bend_angle)[SENT_OFF:]) for run in whole
    ]
    blind = [replace(run, position=None, quaternion=None) for run in runs]
    mixed = [blind[0], *runs[1:]]
    assert preludes(mixed, mixed, finger) == preludes(blind, blind, finger) == preludes(runs, runs, finger)


def test_a_run_under_its_first_pressures_began_there(body: PccSimulator) -> None:
    runs = []
    for recording in made(body, sessions=3).recordings:
        blank = replace(recording, session="day", position=None, quaternion=None)
        runs.append(replay(Plant(body, chain_of(body.robot, ())), blank, 0.01, settle_s=5.0))
    found = preludes(runs, runs, body.robot)
    for recording in runs:
        assert found[recording.name] == pytest.approx(recording.pressure_cmd[0])


def test_the_valve_too_stood_under_what_was_before(body: PccSimulator) -> None:
    """From rest, and from five seconds under no pressure, a lag fills alike."""
    plant = Plant(body, chain_of(body.robot, (Lag(fill_s=LAG_S, vent_s=LAG_S),)))
    (recording,) = made(body, sessions=1).recordings
    straight = replay(plant, recording, 0.01)
    settled = replay(plant, recording, 0.01, settle_s=5.0, before=(0.0,) * 3)
    assert np.abs(settled.pressure_meas - straight.pressure_meas).max() < 1e-9
    assert np.abs(settled.position - straight.position).max() < 2e-4  # gravity had five seconds to act


@pytest.mark.parametrize("first", [SENT_OFF, pytest.param(MIDWAY, marks=pytest.mark.slow)])
def test_a_lag_is_named_wherever_runs_begin(body: PccSimulator, first: int) -> None:
    recordings = lagging(body.with_parameters(axial_stiffness_scale=1.15), first, 4)
    config = configured(candidates=["lag", "viscoelasticity", "delay"])
    found = run(config, body.robot, recordings, body, tracker=NullTracker())
    assert [effect["name"] for effect in found.effects] == ["lag"], found.sentences
    assert found.effects[0]["parameters"]["fill_s"]["value"] == pytest.approx(LAG_S, rel=0.05)


def test_retuning_has_no_second_name() -> None:
    assert Choice("stiffness_scale").retunes
    assert not Choice("stiffness_scale", 1).retunes and not Choice("stiffness_scale", sessions=("day",)).retunes
    assert not Hypothesis((Choice("lag"),), ()).effects[0].retunes


def test_what_follows_from_a_guessed_past_is_not_judged(body: PccSimulator) -> None:
    """One whose chambers were full while its tip was at rest is beyond any guess; a second later that is forgotten."""
    numerics = Numerics(dt_s=0.01, rough_dt_s=0.02, bin_s=0.1, settle_s=2.0, tuned_factor=4.0)
    (recording,) = lagging(body, SENT_OFF, 1).recordings
    problem = Problem(body.robot, body, (recording,), numerics, "motion", "command", False, False)
    (first,) = problem.first
    assert recording.time[first] - recording.time[0] == pytest.approx(1.0, abs=0.021)
    values = np.asarray(recording.position)
    wild = values.copy()
    wild[:first] += 1.0
    np.testing.assert_array_equal(problem.binned(0, wild), problem.binned(0, values))
    (rest,) = made(body, sessions=1).recordings
    assert replace(problem, runs=(rest,)).first == [0]


@pytest.mark.parametrize("poses", [24, 60])
def test_a_table_of_poses_began_at_rest(body: PccSimulator, poses: int) -> None:
    """Rest is at the corner of the pressures' range, where a plane through poses errs by a fifth of it."""
    rng = np.random.default_rng(poses)
    plant, runs = Plant(body, chain_of(body.robot, ())), []
    for k in range(3):
        time = 5.0 * np.arange(1, poses + 1)
        pressures = rng.uniform(0.0, body.robot.pressure_max_pa, (poses, body.robot.chambers))
        blank = Recording(f"run_{k}", f"day_{k}", time, pressures, position=np.zeros((poses, 3)))
        rested = replay(plant, blank, 0.002, settle_s=5.0, before=(0.0,) * body.robot.chambers)
        noisy = rested.position + 1e-4 * rng.standard_normal((poses, 3))
        runs.append(replace(rested, position=noisy, pressure_meas=None, quaternion=None))
    found = preludes(runs, runs, body.robot)
    assert all(np.abs(found[recording.name]).max() < 0.02 * body.robot.pressure_max_pa for recording in runs), found
