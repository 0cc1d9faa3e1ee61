"""Intervals cover under dependent errors, and what is left out is what a fit without it leaves."""

import numpy as np
import pytest

from softrl.diagnosis.fitting.intervals import half_width
from softrl.diagnosis.series.blocks import blocks_of
from softrl.diagnosis.series.least_squares import jackknife, left_out, sandwich
from tests.diagnosis.series import coloured


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


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 4.0])
@pytest.mark.parametrize("runs", [4, 6])
def test_intervals_of_few_runs_are_as_wide_as_they_say(runs: int, share: float) -> None:
    """A mean of run means, each with a variance of one, and runs that differ by ``share`` of it: 90 % of 20 000 intervals."""
    rng = np.random.default_rng(0)
    means = np.sqrt(1.0 + share) * rng.standard_normal((20000, runs))
    within = np.sqrt(rng.chisquare(40, 20000) / 40 / runs)
    reach = half_width(within, 40, np.sqrt(means.var(axis=1, ddof=1) / runs), runs - 1, 0.95)
    assert 0.875 <= np.mean(np.abs(means.mean(axis=1)) < reach) <= 0.93
