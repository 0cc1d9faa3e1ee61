"""Tests keep their level on autocorrelated noise, and find what is there."""

import numpy as np
import pytest
from scipy.signal import lfilter

from softrl.diagnosis.statistics import (
    blocks_of,
    bootstrap_means,
    correlation_time,
    follows,
    holm,
    jackknife,
    left_out,
    sandwich,
    slope_test,
    spectral_line,
    unlike_noise,
    whiteness,
)


def coloured(rng: np.random.Generator, count: int, memory: float) -> np.ndarray:
    noise = rng.standard_normal(count + 500)
    return np.asarray(lfilter([1.0], [1.0, -memory], noise)[500:])


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8])
def test_correlation_time_of_a_first_order_process(memory: float) -> None:
    series = coloured(np.random.default_rng(1), 200_000, memory)
    assert correlation_time(series) == pytest.approx((1.0 + memory) / (1.0 - memory), rel=0.1)


def test_blocks_never_span_runs_and_hold_every_sample() -> None:
    runs = np.repeat([0, 1, 2], [105, 10, 50])
    blocks = blocks_of(runs, 20)
    assert np.all(np.diff(blocks) >= 0) and np.all(np.diff(blocks) <= 1)
    for block in np.unique(blocks):
        assert len(np.unique(runs[blocks == block])) == 1
    assert np.bincount(blocks).min() >= 10


def test_bootstrap_interval_covers_the_mean_of_dependent_samples() -> None:
    rng, hits = np.random.default_rng(2), 0
    for _ in range(200):
        series = coloured(rng, 1000, 0.8)
        means = bootstrap_means(series, blocks_of(np.zeros(1000, int), 40), 400, rng)
        low, high = np.quantile(means, [0.05, 0.95])
        hits += low <= 0.0 <= high
    assert 165 <= hits <= 195, f"90 % interval covered {hits} of 200"


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


def test_sandwich_interval_covers_under_dependent_errors() -> None:
    rng, hits = np.random.default_rng(7), 0
    for _ in range(200):
        jacobian = np.stack([coloured(rng, 1200, 0.9), np.ones(1200)], axis=1)
        error = coloured(rng, 1200, 0.9)
        fitted = np.linalg.lstsq(jacobian, error, rcond=None)[0]
        spread = np.sqrt(sandwich(jacobian, error - jacobian @ fitted, blocks_of(np.zeros(1200, int), 60))[0, 0])
        hits += abs(fitted[0]) <= 1.72 * spread
    assert 160 <= hits <= 195, f"90 % interval covered {hits} of 200"


def test_sandwich_calls_an_unseen_parameter_unknown() -> None:
    rng = np.random.default_rng(8)
    x = rng.standard_normal(300)
    jacobian = np.stack([x, x + 1e-9 * rng.standard_normal(300)], axis=1)
    covariance = sandwich(jacobian, rng.standard_normal(300), blocks_of(np.zeros(300, int), 10))
    alone = sandwich(jacobian[:, :1], rng.standard_normal(300), blocks_of(np.zeros(300, int), 10))
    assert covariance[0, 0] > 100.0 * alone[0, 0]


def test_left_out_is_exact_for_a_linear_fit() -> None:
    rng = np.random.default_rng(9)
    jacobian, target, folds = 1e3 * rng.standard_normal((60, 3)), rng.standard_normal(60), np.arange(60) // 20
    point = np.linalg.lstsq(jacobian, target, rcond=None)[0]
    far = np.full(3, 100.0)
    found = left_out(jacobian, jacobian @ point - target, folds, -far, far)
    for fold in range(3):
        mine = folds == fold
        alone = np.linalg.lstsq(jacobian[~mine], target[~mine], rcond=None)[0]
        np.testing.assert_allclose(found[mine], jacobian[mine] @ alone - target[mine], atol=1e-5)


def test_left_out_stays_within_bounds() -> None:
    jacobian, residual = np.array([[1.0], [1e-3]]), np.array([0.0, 1.0])
    found = left_out(jacobian, residual, np.array([0, 1]), np.array([-0.1]), np.array([0.1]))
    assert np.abs(found - residual).max() <= 0.1 + 1e-9


def test_what_follows_the_drive_is_found_and_noise_with_a_memory_is_not() -> None:
    rng, alarms = np.random.default_rng(10), 0
    for _ in range(200):
        target, drive = ([coloured(rng, 300, 0.95) for _ in range(3)] for _ in range(2))
        alarms += follows(target, drive, 10)[1] < 0.05
    assert alarms <= 22, f"{alarms} of 200 false alarms at 5 %"
    drive = [coloured(rng, 300, 0.9) for _ in range(3)]
    assert follows([0.3 * x + coloured(rng, 300, 0.9) for x in drive], drive, 10)[1] < 1e-6


def test_a_line_in_the_spectrum_is_told_from_a_smooth_one() -> None:
    rng, clock = np.random.default_rng(11), 0.1 * np.arange(400)
    still = [np.zeros((400, 1))]
    smooth = [[coloured(rng, 400, m)[:, None]] for m in (0.0, 0.5, 0.9) for _ in range(50)]
    assert not any(spectral_line(run, still) < 1e-8 for run in smooth)
    swing = np.sin(2.0 * np.pi * 0.5 * clock)[:, None]
    line = swing + 0.3 * coloured(rng, 400, 0.5)[:, None]
    assert spectral_line([line], still) < 1e-8
    assert spectral_line([line], [swing + 0.1 * coloured(rng, 400, 0.5)[:, None]]) > 1e-8, "the drive swings so itself"


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9, 0.97, "mixed"])
@pytest.mark.parametrize(("runs", "length", "holds"), [(1, 120, 4), (2, 300, 20)])
def test_noise_of_any_colour_is_uneven_as_rarely_as_said(
    memory: float | str, runs: int, length: int, holds: int
) -> None:
    rng, alarms, shares = np.random.default_rng(16), 0, []
    for _ in range(60):
        edges = [np.sort(rng.integers(0, length, holds)) for _ in range(runs)]
        drives = [rng.uniform(size=(holds + 1, 2))[np.searchsorted(edge, np.arange(length))] for edge in edges]
        slow = [np.stack([coloured(rng, length, 0.9 if memory == "mixed" else memory) for _ in range(2)], axis=1)
                for _ in range(runs)]  # fmt: skip
        noise = [x + 2.0 * rng.standard_normal(x.shape) if memory == "mixed" else x for x in slow]
        found = unlike_noise(noise, drives, 39, rng)
        alarms += found.p_value <= 0.05
        shares.append(found.share)
    assert alarms <= 8, f"{alarms} of 60 false alarms at 5 %"
    assert np.median(shares) < 0.1, "noise has little power in excess"


def test_the_share_in_excess_is_that_of_the_jumps_and_of_what_comes_with_motion() -> None:
    rng = np.random.default_rng(17)
    drive = np.repeat(rng.uniform(size=(60, 1)), 20, axis=0)
    moves = np.abs(np.diff(drive, axis=0, prepend=drive[:1]))
    quiet, rough = rng.standard_normal((2, 1200, 2))
    with_motion = quiet + rough * np.sqrt(moves / moves.mean())
    assert unlike_noise([with_motion], [drive], 39, rng).share == pytest.approx(0.5, abs=0.12)
    jumps = np.sqrt(40.0) * rough * (np.arange(1200) % 40 == 7)[:, None]
    assert unlike_noise([quiet + jumps], [drive], 39, rng).share == pytest.approx(0.5, abs=0.12)


def test_noise_is_told_from_jumps_and_from_what_comes_with_motion() -> None:
    rng = np.random.default_rng(13)
    drive = np.repeat(rng.uniform(size=(20, 1)), 15, axis=0)
    steps = np.diff(drive, axis=0, prepend=drive[:1])
    noise = coloured(rng, 300, 0.9)[:, None]
    jumped = noise + 8.0 * (np.arange(300) > 150)[:, None]
    assert unlike_noise([jumped], [drive], 200, rng).p_value < 0.02
    late = np.asarray(lfilter([1.0], [1.0, -0.7], np.abs(steps[:, 0]) * rng.standard_normal(300)))[:, None]
    assert unlike_noise([0.2 * noise + 20.0 * late], [drive], 200, rng).p_value < 0.02


def test_what_parameters_a_little_off_leave_is_no_structure() -> None:
    rng = np.random.default_rng(15)
    drive = np.repeat(rng.uniform(size=(20, 1)), 15, axis=0)
    slope = np.asarray(lfilter([1.0], [1.0, -0.8], np.abs(np.diff(drive, axis=0, prepend=drive[:1])), axis=0))
    slow = [coloured(rng, 300, 0.98)[:, None] for _ in range(2)]
    off = [noise + 3.0 * slope for noise in slow]
    assert unlike_noise(off, [drive, drive], 200, rng).p_value < 0.02
    assert unlike_noise(off, [drive, drive], 200, rng, [slope[:, :, None]] * 2).p_value > 0.05
    rough = [noise + 3.0 * slope * rng.standard_normal((300, 1)) for noise in slow]
    assert unlike_noise(rough, [drive, drive], 200, rng, [slope[:, :, None]] * 2).p_value < 0.02


def test_jackknife_sees_what_differs_between_runs() -> None:
    rng, folds, hits, narrow = np.random.default_rng(14), np.repeat(np.arange(6), 100), 0, 0
    for _ in range(200):
        jacobian = rng.standard_normal((600, 1)) + 1.0
        error = rng.standard_normal(600) + 0.5 * rng.standard_normal(6)[folds]
        fitted = np.linalg.lstsq(jacobian, error, rcond=None)[0]
        left = error - jacobian @ fitted
        hits += abs(fitted[0]) < 2.015 * jackknife(jacobian, left, folds)[0]
        narrow += abs(fitted[0]) < 1.645 * np.sqrt(sandwich(jacobian, left, np.arange(600))[0, 0])
    assert 165 <= hits <= 195 and narrow < 140, f"90 % interval covered {hits} and {narrow} of 200"
