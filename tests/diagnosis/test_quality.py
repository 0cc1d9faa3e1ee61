"""Recordings that cannot tell anything are refused in one line with the evidence."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softrl.core.config import build
from softrl.core.tracking import NullTracker
from softrl.diagnosis.checks.quality import mixed, unusable
from softrl.diagnosis.stage import run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.check import check_run
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, made, node


@pytest.fixture(scope="module")
def good(body: PccSimulator) -> RecordingSet:
    return made(body, sessions=3)


def short(r: Recording) -> Recording:
    return thinned(r, np.arange(len(r.time)) < 180)


def clipped(r: Recording) -> Recording:
    assert r.position is not None
    low, high = np.quantile(r.position, [0.3, 0.7], axis=0)
    return replace(r, position=np.clip(r.position, low, high))


def torn(r: Recording) -> Recording:
    return thinned(r, (r.time % 5.0) < 2.5)


def thinned(r: Recording, keep: np.ndarray) -> Recording:
    changed = {name: values[keep] for name, values in r.channels()}
    return replace(r, **changed)


def in_pascal(r: Recording) -> Recording:
    return replace(r, pressure_cmd=1e3 * r.pressure_cmd)


def in_metres(r: Recording) -> Recording:
    assert r.position is not None
    return replace(r, position=1e-3 * r.position)


def another_robot(r: Recording, share: float = 6.0) -> Recording:
    assert r.position is not None
    rest = r.position[0]
    return replace(r, position=rest + (share if r.name == "run_1" else 1.0) * (r.position - rest))


@pytest.mark.parametrize(
    ("spoil", "evidence"),
    [
        (short, "last 10.7 s together"),
        (clipped, "clipped"),
        (torn, "samples are missing"),
        (in_pascal, "3.5e+04 kPa"),
        (in_metres, "mm long: a wrong unit"),
        (another_robot, "mixed robots"),
    ],
)
def test_bad_recordings_cannot_tell(
    body: PccSimulator, good: RecordingSet, spoil: Callable[[Recording], Recording], evidence: str
) -> None:
    spoiled = replace(good, recordings=tuple(spoil(r) for r in good.recordings))
    found = run(configured(), body.robot, spoiled, body, tracker=NullTracker())
    assert found.verdict == "unknown" and found.effects == []
    assert found.sentences[0].startswith("Cannot tell:") and evidence in found.sentences[0]
    assert found.unexplained["cannot_tell"] in found.sentences[0]


def test_a_chamber_at_rest_is_not_clipped(body: PccSimulator) -> None:
    """Chambers driven one by one, before sensors that read no less than zero: two of three are always at their least."""
    robot, time = body.robot, 0.02 * np.arange(1, 1801)
    turn = np.minimum((np.arange(1800) // 600)[:, None] == np.arange(3), 1)
    pressure = turn * (0.5 - 0.5 * np.cos(2.0 * np.pi * time / 4.0))[:, None] * robot.pressure_max_pa
    tip = robot.length_m * np.array([0.0, 0.0, 1.0]) + 1e-6 * pressure
    plain = Recording("run", "day", time, pressure, position=tip + 1e-5 * np.sin(np.outer(time, [1.0, 2.0, 3.0])))
    assert unusable([replace(plain, pressure_meas=pressure)], robot) is None
    assert not any("pressure_meas" in warning for warning in check_run(replace(plain, pressure_meas=pressure), robot).warnings)
    low = np.minimum(pressure, 0.5 * robot.pressure_max_pa)
    limited = replace(plain, pressure_meas=low)  # a supply that gives no more: half of the time it is all there is
    assert unusable([limited], robot) is None
    assert any("pressure_meas[0] is at its maximum" in warning for warning in check_run(limited, robot).warnings)
    stuck = replace(limited, position=np.minimum(np.asarray(plain.position), np.median(tip, axis=0) + 5e-4))
    assert "position[0] sits at its largest" in str(unusable([stuck], robot))


@pytest.mark.parametrize(("same", "share", "refused"), [(True, 0.2, True), (False, 0.2, False), (False, 0.05, True)])
def test_a_loose_hose_in_the_chamber_of_one_session_is_no_other_robot(
    body: PccSimulator, good: RecordingSet, same: bool, share: float, refused: bool
) -> None:
    """Sessions that drive the same chambers are compared, others only where a gain could not explain it."""
    alone = [replace(r, pressure_cmd=r.pressure_cmd * np.eye(3)[0 if same else k]) for k, r in enumerate(good.recordings)]
    made = [replay(Plant(body, chain_of(body.robot, ())), run, 0.01) for run in alone]
    loose = another_robot(made[1], share)
    assert (mixed([made[0], loose, *made[2:]], made, body.robot) is not None) == refused


def test_a_coordinate_of_few_values_is_coarse_and_not_clipped(body: PccSimulator) -> None:
    """Across the plane of a planar robot a camera of 1 mm shows two values, which of them is a matter of its place."""
    planar = replace(body.robot, chamber_angle_deg=(0.0, 180.0))
    runs = made(PccSimulator(robot=planar, **node("simulator/pcc.yaml")), sessions=2, noise_m=2e-4).recordings
    coarse = [replace(run, position=np.round(np.asarray(run.position) + 5e-4 * np.eye(3)[1], 3)) for run in runs]
    assert unusable(coarse, planar) is None
    assert "position[0] sits" in str(unusable([clipped(run) for run in coarse], planar))


def test_what_a_robot_does_not_report_may_be_clipped() -> None:
    finger = build(node("robot/single_chamber_finger.yaml"), Robot, "robot")
    runs = made(PccSimulator(robot=finger, **node("simulator/pcc.yaml")), sessions=2).recordings
    assert unusable([clipped(run) for run in runs], finger) is None
    low, high = np.quantile(np.concatenate([np.asarray(run.bend_angle) for run in runs]), [0.3, 0.7])
    held = [replace(run, bend_angle=np.clip(np.asarray(run.bend_angle), low, high)) for run in runs]
    assert "bend_angle[0] sits" in str(unusable(held, finger))


def test_a_rest_between_poses_is_not_clipped() -> None:
    """One row a pose, every other at rest, before a coarse sensor: half of the samples are its least value."""
    rng, finger = np.random.default_rng(1), build(node("robot/single_chamber_finger.yaml"), Robot, "robot")
    level = rng.uniform(0.1, 1.0, (100, 1))
    level[::2] = 0.0
    degrees, pressure = 68.0 * level[:, 0], level * finger.pressure_max_pa
    table = Recording("poses", "day", 20.0 * np.arange(100), pressure, bend_angle=np.deg2rad(degrees.round()))
    assert unusable([table], finger) is None
    short = replace(table, bend_angle=np.deg2rad(np.minimum(degrees, 34.0).round()))
    assert "bend_angle[0] sits at its largest" in str(unusable([short], finger))
    low = replace(table, bend_angle=np.deg2rad(np.maximum(degrees, 34.0).round()))
    assert "bend_angle[0] sits at its largest" in str(unusable([low], finger))


def test_an_angle_that_jumps_by_a_turn_is_told() -> None:
    finger = build(node("robot/single_chamber_finger.yaml"), Robot, "robot")
    time, turn = 0.05 * np.arange(400), np.linspace(0.0, 4.0, 400)
    curling = Recording("curl", "day", time, turn[:, None] / 4.0 * finger.pressure_max_pa, bend_angle=turn)
    assert unusable([curling], finger) is None
    wrapped = replace(curling, bend_angle=np.arctan2(np.sin(turn), np.cos(turn)))
    assert "run curl jumps by a turn at 180 deg" in str(unusable([wrapped], finger))


def test_a_turned_frame_is_seen_and_does_not_become_physics(body: PccSimulator, good: RecordingSet) -> None:
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    runs = tuple(replace(r, position=r.position @ turn.T, quaternion=None) for r in good.recordings)
    found = run(configured(), body.robot, replace(good, recordings=runs), body, tracker=NullTracker())
    assert found.verdict == "nothing missing", found.sentences
    assert any("frame" in line for line in found.data["warnings"])
