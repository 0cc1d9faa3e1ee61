"""Tests keep their level on autocorrelated noise, and find what is there."""

import numpy as np
import pytest

from softrl.diagnosis.series.blocks import blocks_of
from softrl.diagnosis.series.statistics import follows, holm, slope_test, whiteness
from tests.diagnosis.series import coloured


def test_holm_by_hand_and_never_below_the_raw_value() -> None:
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])
    p = np.random.default_rng(3).uniform(size=50)
    assert np.all(holm(p.tolist()) >= p)


def test_slope_test_keeps_its_level_where_a_naive_test_fails() -> None:
    rng, robust, naive = np.random.default_rng(4), 0, 0
    blocks = blocks_of(np.zeros(1500, int), 50)
    for _ in range(300):
        x, y = coloured(rng, 1500, 0.9), coloured(rng, 1500, 0.9)
        robust += slope_test(y, x, blocks)[1] < 0.05
        naive += slope_test(y, x, np.arange(1500))[1] < 0.05
    assert robust <= 33, f"{robust} of 300 false alarms at 5 %"
    assert naive > 90


def test_slope_test_finds_a_weak_dependence() -> None:
    rng = np.random.default_rng(5)
    x = coloured(rng, 3000, 0.8)
    size, p_value = slope_test(0.3 * x + coloured(rng, 3000, 0.8), x, blocks_of(np.zeros(3000, int), 50))
    assert p_value < 1e-3
    assert size == pytest.approx(0.3 / np.hypot(0.3, 1.0), abs=0.1)


def test_whiteness_keeps_its_level_and_rejects_colour() -> None:
    rng = np.random.default_rng(6)
    alarms = sum(whiteness(rng.standard_normal(400), 15)[1] < 0.05 for _ in range(400))
    assert 8 <= alarms <= 36
    assert whiteness(coloured(rng, 400, 0.5), 15)[1] < 1e-6


def test_what_follows_the_drive_is_found_and_noise_with_a_memory_is_not() -> None:
    rng, alarms = np.random.default_rng(10), 0
    for _ in range(200):
        target, drive = ([coloured(rng, 300, 0.95) for _ in range(3)] for _ in range(2))
        alarms += follows(target, drive, 10)[1] < 0.05
    assert alarms <= 22, f"{alarms} of 200 false alarms at 5 %"
    drive = [coloured(rng, 300, 0.9) for _ in range(3)]
    assert follows([0.3 * x + coloured(rng, 300, 0.9) for x in drive], drive, 10)[1] < 1e-6
