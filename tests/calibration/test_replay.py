"""What a simulator that is right does under a recording's commands is what was recorded, however it was sampled or began."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from softrl.calibration.holds import Holds
from softrl.calibration.replay import Stepping, replay, replay_errors
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

LAG, CREEP = Lag(0.3, 0.5), Viscoelasticity(0.3, 4.0, 0.0, 20.0)


@cache
def levels() -> np.ndarray:
    return np.random.default_rng(2).uniform(-2e4, 3.5e4, (8, 3))


def recorded(plant: Plant, row_s: float, stood_s: float, first: np.ndarray) -> Recording:
    """Return holds of 2 s from ``first`` (3,) Pa on, sampled every ``row_s``, of a robot that stood under the first."""
    command = np.repeat(np.vstack([first, levels()]), round(2.0 / 0.01), axis=0)
    whole = np.vstack([np.repeat(command[:1], round(stood_s / 0.01), axis=0), command])
    made = plant.simulate(0.01 * np.arange(1, len(whole) + 1), whole)
    every = round(row_s / 0.01)
    time, seen = 0.01 * np.arange(1, len(command) + 1), made.position[-len(command) :]
    return Recording("r", "s", *(values[every - 1 :: every] for values in (time, command)), position=seen[every - 1 :: every])


def miss_mm(plant: Plant, recording: Recording) -> float:
    made = replay(plant, [recording], lambda pressure: pressure, Stepping(0.01, 20.0))[0]
    return 1e3 * float(np.sqrt(np.mean(np.sum((made.position - recording.position) ** 2, axis=1))))


@pytest.mark.parametrize("effects", [(), (LAG,)])
@pytest.mark.parametrize("row_s", [0.02, 0.2, 1.0])
def test_rows_far_apart_are_no_steps_of_the_simulator(
    robot: Robot, body: PccSimulator, effects: tuple[Effect, ...], row_s: float
) -> None:
    plant = Plant(body, chain_of(robot, effects))
    assert miss_mm(plant, recorded(plant, row_s, 0.0, np.zeros(3))) < 0.01


@pytest.mark.parametrize("lost", [[], list(range(110, 160)), [k for k in range(1, 900, 3) if 5 < k % 100 < 95]])
def test_a_velocity_is_that_of_the_motion_whatever_rows_were_lost(robot: Robot, body: PccSimulator, lost: list[int]) -> None:
    """A tip that is seen 5 mm/s too fast is so over a pause and where every third row was dropped, too."""
    plant = Plant(body, chain_of(robot, ()))
    whole = recorded(plant, 0.02, 0.0, np.zeros(3))
    rows = np.delete(np.arange(len(whole.time)), lost)
    drifting = replace(whole, position=whole.position + np.outer(whole.time, [5e-3, 0.0, 0.0]))
    seen = replace(drifting, **drifting.part(rows))
    holds = Holds(seen.pressure_cmd[-1:], seen.position[-1:], np.array([0]), np.array([len(rows) - 1]))
    found = replay_errors(plant, RecordingSet(robot.name, (seen,)), holds, {0: 0}, lambda p: p, Stepping(0.01, 20.0))
    assert found["velocity_run_mm_s"] == pytest.approx(5.0, rel=0.02)


@pytest.mark.parametrize("stood_s", [0.0, 40.0])
def test_a_run_begins_where_its_first_pose_says(robot: Robot, body: PccSimulator, stood_s: float) -> None:
    """At rest with a first step, or under a first pressure for long, to which walls have crept."""
    plant = Plant(body, chain_of(robot, [CREEP, LAG]))
    assert miss_mm(plant, recorded(plant, 0.02, stood_s, np.array([3e4, 1e4, 0.0]))) < 0.3
