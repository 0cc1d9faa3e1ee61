"""Readings of a slow sensor are looked for in no more periods than their samples can tell apart."""

import numpy as np
import pytest

from softrl.effects.hold import _Changes, reading_period


def run(rate_hz: float, seconds: float, period_s: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return times and a motion that is read every ``period_s``."""
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    moved = np.sin(2.0 * np.pi * np.outer(period_s * np.floor(time / period_s + 1e-6), (0.4, 1.1, 1.7)) + seed)
    return time, moved + 1e-3 * np.random.default_rng(seed).standard_normal(moved.shape)


@pytest.mark.parametrize("slow_s", [0.0, 300.0])
def test_fast_runs_beside_a_slow_one_and_pauses_cost_no_more_periods(
    slow_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried, coincidence = [], _Changes.coincidence
    monkeypatch.setattr(_Changes, "coincidence", lambda self, period: tried.append(period) or coincidence(self, period))
    series = [run(1000.0, 4.0, 0.03, k) for k in range(3)]
    if slow_s:
        series.append(run(10.0, slow_s, 0.1, 7))
    time, moved = series[0]
    series[0] = (np.where(time < 0.5, time, time + 3600.0), moved)  # somebody had lunch
    found = reading_period(series)
    assert found is not None and abs(found - 0.03) < 1e-4
    assert len(tried) < 50_000
