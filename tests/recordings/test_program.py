"""Laws of the pressure programs: within limits and slew, on a uniform grid, and recorded as applied."""

from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
import pytest
import yaml

from softrl.core.driver import Sample
from softrl.core.errors import DriverError
from softrl.recordings import program
from softrl.recordings.recording import RecordingSet
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


@pytest.mark.parametrize("kind", ["steps", "multisine", "triangles", "staircase"])
def test_what_must_stay_under_pressure_begins_there(kind: str) -> None:
    """A robot that must not be vented is never sent less than its least pressure, nor one that sucks more than its largest."""
    for limits in ((10e3, 35e3), (-35e3, -10e3)):
        robot = replace(TRIPOD, pressure_min_pa=limits[0], pressure_max_pa=limits[1])
        _, pressure = programs(robot)[kind]
        assert limits[0] <= pressure.min() and pressure.max() <= limits[1]


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


def samples_with(gaps: dict[str, list[int]], count: int = 20) -> list[Sample]:
    """Return samples of which the numbered ones in ``gaps`` lack a field; in an empty list all do."""
    made = []
    for k in range(count):
        values = {
            "commanded": np.full(3, 1e3 * k), "pressure": np.full(3, 9e2 * k), "position": np.array([0.0, 1e-3 * k, 0.2]),
            "quaternion": np.array([1.0, 0.0, 0.0, 0.0]), "tip_force": np.zeros(3),
        }  # fmt: skip
        for name, rows in gaps.items():
            if k in rows or not rows:
                values[name] = np.full_like(values[name], np.nan)
        made.append(Sample(0.01 * k, **values))
    return made


def test_what_the_device_does_not_measure_is_none(caplog: pytest.LogCaptureFixture) -> None:
    run = program.recording_of(samples_with({"pressure": [], "quaternion": [], "tip_force": []}), TRIPOD, "a", "s")
    assert run.pressure_meas is None and run.quaternion is None and run.tip_force is None
    assert len(run.time) == 20 and not caplog.records
    RecordingSet("tripod", (run,)).validate()


def test_samples_that_lack_a_reading_are_left_out_and_told(caplog: pytest.LogCaptureFixture) -> None:
    run = program.recording_of(samples_with({"position": [3], "pressure": [3, 7]}), TRIPOD, "a", "s")
    RecordingSet("tripod", (run,)).validate()
    assert run.position is not None and run.pressure_meas is not None
    np.testing.assert_array_equal(run.time, 0.01 * np.delete(np.arange(20), [3, 7]))
    np.testing.assert_allclose(run.position[:, 1], run.pressure_cmd[:, 0] * 1e-6)
    assert "2 of 20 samples lack a reading" in caplog.text


def test_a_channel_that_is_seldom_measured_does_not_cost_the_others(caplog: pytest.LogCaptureFixture) -> None:
    run = program.recording_of(samples_with({"pressure": list(range(5, 20))}), TRIPOD, "a", "s")
    assert run.pressure_meas is None and len(run.time) == 20
    assert "pressure_meas is measured in 5 of 20 samples" in caplog.text


def test_a_position_counts_however_seldom_the_camera_looks() -> None:
    run = program.recording_of(samples_with({"position": [k for k in range(20) if k % 4]}), TRIPOD, "a", "s")
    assert run.position is not None and len(run.time) == 5


def test_samples_without_a_command_are_an_error() -> None:
    with pytest.raises(DriverError, match="0 of 20 samples have values in all channels"):
        program.recording_of(samples_with({"commanded": []}), TRIPOD, "a", "s")
