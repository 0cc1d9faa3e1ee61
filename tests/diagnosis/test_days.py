"""A base mounted anew every day, and a wall as stiff as the day is warm, are nothing that a simulator leaves out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.problem import Numerics, Problem
from softrl.diagnosis.judging.correct import Model, traces
from softrl.diagnosis.stage import run
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.lost import lost
from softrl.recordings.recording import Recording, RecordingSet
from tests.diagnosis.conftest import configured, programs

STIFFER = 0.015, -0.01, -0.005
TURNS_DEG = (0.4, 0.0, 0.2), (-0.3, 0.3, 0.0), (0.0, -0.4, 0.3)
SHIFTS_MM = (0.5, 0.0, 0.2), (-0.4, 0.3, 0.0), (0.0, -0.5, 0.3)
RIVALS = ["lag", "hysteresis", "offset"]


def recorded(
    body: PccSimulator, effects: tuple[Effect, ...] = (), warmth: float = 1.0, mount: float = 1.0, twist: float = 0.0
) -> RecordingSet:
    """Return two runs on each of three days, which differ by multiples of the above; a bend may ``twist`` the tip aside."""
    rng, runs = np.random.default_rng(0), []
    for day, (stiffer, turn, shift) in enumerate(zip(STIFFER, TURNS_DEG, SHIFTS_MM, strict=True)):
        scales = {name: 1.0 + warmth * stiffer for name in ("bending_stiffness_scale", "axial_stiffness_scale")}
        plant = Plant(body.with_parameters(**scales), chain_of(body.robot, effects))
        mounted = Rotation.from_rotvec(mount * np.deg2rad(turn))
        for number in range(2):
            time, pressure = programs(body.robot, rng, 0.04)
            made = replay(plant, Recording(f"run_{day}{number}", f"day_{day}", time, pressure), 0.01)
            assert made.position is not None
            aside = np.cross([0.0, 0.0, 1.0], made.position) * np.linalg.norm(made.position[:, :2], axis=1, keepdims=True)
            tip = mounted.apply(made.position + twist * aside) + 1e-3 * mount * np.array(shift)
            noisy = tip + 1e-4 * rng.standard_normal(tip.shape)
            runs.append(replace(made, position=noisy, quaternion=None, pressure_meas=None))
    return RecordingSet(robot_name=body.robot.name, recordings=tuple(runs))


def diagnosed(body: PccSimulator, recordings: RecordingSet) -> Diagnosis:
    return run(configured(candidates=RIVALS), body.robot, recordings, body, tracker=NullTracker())


def is_told_of_mounts(found: Diagnosis) -> bool:
    return any("mounted a little otherwise" in line for line in found.data["warnings"])


def test_each_session_is_placed_within_what_nobody_avoids(body: PccSimulator) -> None:
    numerics = Numerics(0.01, 0.02, 0.1, 1.0, 4.0)
    for mount in (1.0, 6.0):
        runs = tuple(lost(run, (run.time > 2.0) & (run.time < 5.0)) for run in recorded(body, warmth=0.0, mount=mount).recordings)
        alike = Problem(body.robot, body, runs, numerics, "motion", "command", False, False)
        left, placed = (
            problem.residual(Hypothesis((), ()), np.zeros(0)) for problem in (alike, replace(alike, mounted=True))
        )
        assert np.sqrt(left.squares.mean()) > 1e-3 * mount
        turns = [np.degrees(np.arccos(0.5 * (np.trace(turn) - 1.0))) for turn, _ in placed.registrations.values()]
        shifts = [np.linalg.norm(shift) for _, shift in placed.registrations.values()]
        assert max(turns) < 1.0 + 1e-6 and max(shifts) < 0.01 * body.robot.length_m + 1e-9
        if mount == 1.0:
            np.testing.assert_allclose(turns, np.linalg.norm(TURNS_DEG, axis=1), atol=0.05)
            np.testing.assert_allclose(np.multiply(shifts, 1e3), np.linalg.norm(SHIFTS_MM, axis=1), atol=0.1)
            assert np.sqrt(placed.squares.mean()) < 2e-4
            model = Model(Hypothesis((), ()), np.zeros(0), placed.registrations)
            assert traces(replace(alike, mounted=True), model).rms < 3e-4


@pytest.mark.slow
def test_days_that_differ_a_little_hide_and_invent_nothing(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body))
    assert found.verdict == "nothing missing", found.sentences
    told = found.data["sessions_differ"]
    stiffer = np.array([day["stiffer"] for day in told])
    np.testing.assert_allclose(stiffer - stiffer.mean(), np.array(STIFFER) - np.mean(STIFFER), atol=2e-3)
    turns, shifts = (np.linalg.norm(x, axis=1) for x in (TURNS_DEG, SHIFTS_MM))
    np.testing.assert_allclose([np.degrees(day["turn_rad"]) for day in told], turns, atol=0.15)
    np.testing.assert_allclose([1e3 * day["shift_m"] for day in told], shifts, atol=0.5)
    assert any("sessions differ a little in themselves" in line for line in found.sentences)


@pytest.mark.slow
def test_a_lag_beside_such_days_is_named(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, (Lag(fill_s=0.2, vent_s=0.2),)))
    assert [effect["name"] for effect in found.effects] == ["lag"], found.sentences
    assert found.verdict == "named" and is_told_of_mounts(found)
    assert found.effects[0]["parameters"]["fill_s"]["value"] == pytest.approx(0.2, rel=0.05)


@pytest.mark.slow
def test_days_are_told_beside_what_is_understood_without_them(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, (Lag(fill_s=0.2, vent_s=0.2),), warmth=0.35, mount=0.35))
    assert found.verdict == "named" and [effect["name"] for effect in found.effects] == ["lag"], found.sentences
    assert not is_told_of_mounts(found), "no second look where the first has understood"
    stiffer = np.array([day["stiffer"] for day in found.data["sessions_differ"]])
    np.testing.assert_allclose(stiffer - stiffer.mean(), 0.35 * (np.array(STIFFER) - np.mean(STIFFER)), atol=2e-3)
    assert any("sessions differ a little in themselves: 0.1" in line for line in found.sentences), found.sentences


@pytest.mark.slow
def test_what_no_day_explains_stays_unknown(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, twist=2.0))
    assert found.verdict == "unknown", found.sentences
    assert not found.data["sessions_differ"]


@pytest.mark.slow
def test_days_that_differ_by_much_are_not_taken_for_granted(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, mount=6.0))
    assert not is_told_of_mounts(found) and not found.data["sessions_differ"]
    assert found.verdict != "nothing missing", found.sentences


@pytest.mark.slow
def test_days_that_do_not_differ_are_not_told(body: PccSimulator) -> None:
    found = diagnosed(body, recorded(body, warmth=0.0, mount=0.0))
    assert found.verdict == "nothing missing", found.sentences
    assert not is_told_of_mounts(found) and not found.data["sessions_differ"]
