"""A length that the robot's file says wrongly is told before any effect is named for it."""

from dataclasses import replace

import numpy as np

from softrl.diagnosis.checks.reach import of_other_length
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot


def run_at(tripod: Robot, share: float, pressure_pa: float = 0.0, session: str = "day") -> Recording:
    """Return a run of a second whose tip stands straight, at ``share`` of the robot's length from the base."""
    time = np.arange(50) * 0.02
    tip = np.tile([0.0, 0.0, share * tripod.length_m], (50, 1))
    return Recording("run", session, time, np.full((50, tripod.chambers), pressure_pa), position=tip)


def test_a_tip_that_rests_elsewhere_than_the_length_has_it_is_told_in_numbers(tripod: Robot) -> None:
    told = of_other_length([run_at(tripod, 0.95), run_at(tripod, 0.951)], tripod)
    assert told is not None and f"{950.5 * tripod.length_m:.4g} mm" in told and f"{1e3 * tripod.length_m:.4g} mm" in told
    assert of_other_length([run_at(tripod, 0.98), run_at(tripod, 0.98)], tripod) is None, "weight does as much"


def test_it_is_told_by_runs_that_begin_without_pressure_and_agree(tripod: Robot) -> None:
    pressed = run_at(tripod, 1.2, 0.5 * tripod.pressure_max_pa)
    assert of_other_length([pressed], tripod) is None
    assert of_other_length([run_at(tripod, 0.9), run_at(tripod, 1.1)], tripod) is None, "something changed between the runs"
    assert of_other_length([run_at(tripod, 0.9), pressed], tripod) is not None
    assert of_other_length([run_at(tripod, 0.9)], replace(tripod, output="bend_angle")) is None
