"""Tracking that held something else for seconds: found, while what a body does itself stays."""

import numpy as np
import pytest

from softrl.diagnosis.checks.strayed import strayed

TIME = 0.02 * np.arange(3000)
STILL = np.zeros((3000, 3))
OFF = 6.0 * np.array([0.4, 0.9, 0.1])


def _motion(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a slow swing (steps, 3) mm with noise, and the pressure that brings it about."""
    drive = np.sin(0.3 * TIME) + 0.4 * np.sin(0.8 * TIME + seed)
    noise = 0.02 * np.random.default_rng(seed).standard_normal((3000, 3))
    return 9.0 * np.outer(drive, [1.0, 0.3, 0.1]) + noise, drive[:, None]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_marker_that_is_taken_for_another_to_and_fro_is_found(seed: int) -> None:
    moved, drive = _motion(seed)
    rng = np.random.default_rng(seed)
    away = np.zeros(3000, dtype=bool)
    for start in (400, 1300, 2200):
        away[start : start + 20] = True  # for longer than an instant
        away[start + 150 : start + 350] = rng.random(200) < 0.5  # to and fro
    found = strayed(TIME, moved + np.outer(away, OFF), drive)
    np.testing.assert_array_equal(found, away)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_jump_that_stays_and_one_that_takes_longer_are_left(seed: int) -> None:
    moved, drive = _motion(seed)
    assert not strayed(TIME, moved, drive).any()
    assert not strayed(TIME, moved + np.outer(TIME > 30.0, OFF), drive).any()
    assert not strayed(TIME, moved + np.outer((TIME > 20.0) & (TIME < 26.0), OFF), drive).any()


@pytest.mark.parametrize("every", [1, 5, 20])
def test_a_body_that_follows_its_pressure_at_once_does_not_stray(every: int) -> None:
    time = TIME[::every]
    pulse = ((time % 3.0) < 0.8).astype(float)
    lagged = np.r_[0.0, pulse[:-1]]
    for answer in (pulse, lagged):
        assert not strayed(time, np.outer(answer, OFF), pulse[:, None]).any()


def test_a_swing_after_a_blow_does_not_stray() -> None:
    since = np.maximum(TIME - 20.0, 0.0)
    swing = np.outer(np.exp(-since / 0.5) * np.sin(40.0 * since), OFF)
    moved = swing + 0.01 * np.random.default_rng(0).standard_normal((3000, 3))
    assert not strayed(TIME, moved, STILL).any()


@pytest.mark.parametrize("digit", [0.5, 1.0])
def test_one_digit_of_a_coarse_sensor_is_no_jump(digit: float) -> None:
    moved, drive = _motion(1)
    slow = np.interp(TIME / 20.0, TIME, moved[:, 0])[:, None]
    assert not strayed(TIME, np.round(slow / digit) * digit, np.interp(TIME / 20.0, TIME, drive[:, 0])[:, None]).any()
