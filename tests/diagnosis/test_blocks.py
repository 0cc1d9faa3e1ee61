"""Blocks hold what depends on each other, and intervals from them cover."""

import numpy as np
import pytest

from softrl.diagnosis.series.blocks import blocks_of, bootstrap_means, correlation_time, expanded
from tests.diagnosis.series import coloured


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


@pytest.mark.parametrize("count", [6, 12, 40])
def test_intervals_cover_with_few_blocks_of_skewed_errors(count: int) -> None:
    rng, hits = np.random.default_rng(3), 0
    blocks = np.arange(20 * count) // 20
    level = expanded(0.95, blocks)
    for _ in range(400):
        series = coloured(rng, len(blocks), 0.5) ** 2
        low, high = np.quantile(bootstrap_means(series, blocks, 400, rng), [1.0 - level, level])
        hits += low <= 1.0 / (1.0 - 0.5**2) <= high
    assert 335 <= hits <= 380, f"90 % interval covered {hits} of 400"
