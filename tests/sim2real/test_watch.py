"""Laws of the watch over the air lines: slow valves and wrong sensors are whole, a line that is off is not."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError
from softrl.sim2real.watch import LineWatch, Watch

SETTINGS = Watch(settle_s=2.0, fault_kpa=3.0, after_s=0.4, afresh_steps=3)


def period(start_s: float, told_kpa: np.ndarray, measured_kpa: np.ndarray) -> list[Sample]:
    """Return the samples of 0.5 s, twenty a second, of pressures (10,) kPa of one chamber."""
    still, upright, nothing = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.full(3, np.nan)
    return [
        Sample(start_s + 0.05 * (k + 1), np.array([1e3 * told]), np.array([1e3 * measured]), still, upright, nothing)
        for k, (told, measured) in enumerate(zip(told_kpa, measured_kpa, strict=True))
    ]


def judged(told_kpa: np.ndarray, measured_kpa: np.ndarray, healthy: int = 1) -> list[bool]:
    """Return what the watch thinks after each period; the first ``healthy`` ones are known to be."""
    watch, trusted = LineWatch(SETTINGS), []
    for k in range(len(told_kpa) // 10):
        mine = slice(10 * k, 10 * k + 10)
        watch.advance(period(0.5 * k, told_kpa[mine], measured_kpa[mine]), healthy=k < healthy)
        trusted.append(watch.trusted)
    return trusted


def test_a_slow_valve_is_whole() -> None:
    told = 20.0 * (np.arange(200) // 35 % 2)
    measured = np.zeros(200)
    for k in range(1, 200):
        measured[k] = measured[k - 1] + (told[k] - measured[k - 1]) * 0.05 / 0.6
    assert all(judged(told, measured))


def test_a_line_that_is_off_is_found_and_forgiven() -> None:
    told = np.full(120, 15.0)
    measured = told.copy()
    measured[30:60] = 0.0
    trusted = judged(told, measured)
    assert trusted == [True] * 3 + [False] * 3 + [True] * 6


def test_a_wrong_sensor_is_known_from_the_approach() -> None:
    told = 15.0 + 2.0 * np.sin(0.05 * np.arange(120))
    assert all(judged(told, told + 8.0))


def test_a_lost_reading_does_not_hide_a_line_that_is_off() -> None:
    told = np.full(120, 15.0)
    measured = told.copy()
    measured[30:90] = 0.0
    measured[57] = np.nan
    assert judged(told, measured) == [True] * 3 + [False] * 6 + [True] * 3


def test_a_wrong_sensor_hides_no_other_line_that_is_off() -> None:
    watch, told, right = LineWatch(SETTINGS), np.full(10, 15.0), np.full(10, 15.0)
    for k, second in enumerate((right, right, 0.0 * right)):
        pairs = zip(period(0.5 * k, told, told + 14.0), period(0.5 * k, told, second), strict=True)
        both = [
            replace(a, commanded=np.append(a.commanded, b.commanded), pressure=np.append(a.pressure, b.pressure))
            for a, b in pairs
        ]
        watch.advance(both, healthy=k < 2)
    np.testing.assert_array_equal(watch.off, [False, True])


def test_a_robot_without_pressure_sensors_is_trusted() -> None:
    assert all(judged(np.full(60, 15.0), np.full(60, np.nan)))


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"watch\.fault_kpa=0"):
        Watch(2.0, 0.0, 0.4, 3)
    with pytest.raises(ConfigError, match=r"watch\.after_s=-1"):
        Watch(2.0, 3.0, -1.0, 3)
