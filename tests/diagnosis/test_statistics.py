"""Tests keep their level on autocorrelated noise, and find what is there."""

import numpy as np
import pytest
from scipy import stats

from softrl.diagnosis.series.blocks import blocks_of
from softrl.diagnosis.series.statistics import follows, holm, slope_test
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


def test_slope_test_has_two_degrees_of_freedom_less_than_blocks_where_all_tell_alike() -> None:
    rng = np.random.default_rng(7)
    x, y = np.tile([1.0, -1.0, 2.0, -2.0], 10), rng.standard_normal(40)
    blocks = blocks_of(np.zeros(40, int), 4)
    slope = float(x @ (y - y.mean())) / float(x @ x)
    score = (x * (y - y.mean() - slope * x)).reshape(10, 4).sum(axis=1)
    spread = np.sqrt(10 / 9 * float(score @ score)) / float(x @ x)
    assert slope_test(y, x, blocks)[1] == pytest.approx(2.0 * stats.t.sf(abs(slope) / spread, 8))


def running_maximum(rng: np.random.Generator) -> np.ndarray:
    return np.maximum.accumulate(np.r_[np.zeros(20), np.repeat(rng.uniform(0.0, 1.0, 14), 20)])


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_few_steps_of_a_running_maximum_are_no_more_significant_in_noise_than_anything(memory: float) -> None:
    rng, p_values = np.random.default_rng(11), []
    for _ in range(300):
        target = [coloured(rng, 300, memory) for _ in range(3)]
        p_values.append(follows(target, [running_maximum(rng) for _ in range(3)], 10)[1])
    assert np.mean(np.array(p_values) < 0.05) < 0.075 and np.mean(np.array(p_values) < 0.01) < 0.02
    assert min(p_values) > 1e-4


def test_what_follows_a_running_maximum_is_found_and_one_jump_alone_says_nothing() -> None:
    rng = np.random.default_rng(12)
    drive = [running_maximum(rng) for _ in range(3)]
    assert follows([2.0 * x + coloured(rng, 300, 0.7) for x in drive], drive, 10)[1] < 0.01
    jump = np.zeros(300)
    jump[100:110] = 1.0
    assert slope_test(5.0 * jump + rng.standard_normal(300), jump, blocks_of(np.zeros(300, int), 10)) == (0.0, 1.0)


def test_what_follows_the_drive_is_found_and_noise_with_a_memory_is_not() -> None:
    rng, alarms = np.random.default_rng(10), 0
    for _ in range(200):
        target, drive = ([coloured(rng, 300, 0.95) for _ in range(3)] for _ in range(2))
        alarms += follows(target, drive, 10)[1] < 0.05
    assert alarms <= 22, f"{alarms} of 200 false alarms at 5 %"
    drive = [coloured(rng, 300, 0.9) for _ in range(3)]
    assert follows([0.3 * x + coloured(rng, 300, 0.9) for x in drive], drive, 10)[1] < 1e-6
