"""Laws of the pressure programs: within limits and slew, on a uniform grid, and recorded as applied."""

from pathlib import Path
from typing import Self

import numpy as np
import pytest
import yaml

from softrl.core.driver import Sample
from softrl.core.errors import DriverError
from softrl.recordings import program
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"


def robot_named(name: str) -> Robot:
    return Robot(**yaml.safe_load((CONF / "robot" / f"{name}.yaml").read_text()))


TRIPOD = robot_named("tripod")


def programs(robot: Robot) -> dict[str, program.Program]:
    rng = np.random.default_rng(1)
    return {
        "steps": program.random_steps(robot, 6, 1.0, 0.01, rng),
        "multisine": program.multisine(robot, 20.0, (0.1, 3.0), 0.9, 0.01, rng),
        "triangles": program.triangles(robot, 0, 0.8 * robot.pressure_max_pa, (1.0, 10.0), 2, 0.01),
        "staircase": program.staircase(robot, robot.chambers - 1, 3, 2, 2.0, 0.01),
    }


@pytest.mark.parametrize("name", ["tripod", "three_chamber_segment", "single_chamber_finger"])
@pytest.mark.parametrize("kind", ["steps", "multisine", "triangles", "staircase"])
def test_program_keeps_limits_and_slew(name: str, kind: str) -> None:
    robot = robot_named(name)
    time, pressure = programs(robot)[kind]
    np.testing.assert_allclose(np.diff(time), 0.01)
    assert pressure.shape == (len(time), robot.chambers)
    assert pressure.min() >= robot.pressure_min_pa and pressure.max() <= robot.pressure_max_pa
    rate = np.abs(np.diff(pressure, axis=0, prepend=np.zeros((1, robot.chambers)))) / 0.01
    assert rate.max() <= robot.slew_pa_per_s * (1 + 1e-9)
    assert np.ptp(pressure) > 0.3 * robot.pressure_max_pa


def test_lines_of_the_multisine_belong_to_one_chamber() -> None:
    _, pressure = program.multisine(TRIPOD, 40.0, (0.1, 2.0), 0.5, 0.01, np.random.default_rng(2))
    settled = pressure[len(pressure) // 2 :]  # after the fade-in; half the record holds every second line only
    power = np.abs(np.fft.rfft(settled - settled.mean(axis=0), axis=0)) ** 2
    assert not np.allclose(power[:, 0], power[:, 1])


def test_staircase_repeats_each_maximum() -> None:
    _, pressure = program.staircase(TRIPOD, 0, 3, 2, 2.0, 0.01)
    peaks = pressure[:, 0].reshape(6, 200).max(axis=1)
    np.testing.assert_allclose(peaks, TRIPOD.pressure_max_pa * np.repeat([1 / 3, 2 / 3, 1.0], 2))


class Echo:
    """A driver whose samples repeat the command, halved: what was applied differs from what was wished."""

    def __init__(self, silent: bool = False) -> None:
        self.time, self.sent, self.silent = 7.0, np.zeros(3), silent

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def command(self, pressure: np.ndarray) -> np.ndarray:
        self.sent = 0.5 * pressure
        return self.sent

    def advance(self, dt_s: float) -> list[Sample]:
        self.time += dt_s
        pose = np.array([1.0, 0, 0, 0])
        return [] if self.silent else [Sample(self.time, self.sent, self.sent, np.zeros(3), pose, np.zeros(3))]


def test_record_keeps_what_was_applied() -> None:
    time, pressure = program.random_steps(TRIPOD, 3, 0.2, 0.01, np.random.default_rng(3))
    with Echo() as driver:
        run = program.record(driver, TRIPOD, time, pressure, "a", "s")
    np.testing.assert_allclose(run.pressure_cmd, 0.5 * pressure)
    np.testing.assert_allclose(run.time, 7.0 + time)


def test_silent_driver_is_an_error() -> None:
    time, pressure = program.random_steps(TRIPOD, 3, 0.2, 0.01, np.random.default_rng(3))
    with pytest.raises(DriverError, match="0 samples"):
        program.record(Echo(silent=True), TRIPOD, time, pressure, "a", "s")
