"""A swing shows in a spectrum of any smooth shape, and none where there is none."""

import tracemalloc

import numpy as np
from scipy.signal import butter, sosfilt

from softrl.diagnosis.series.spectrum import FAR, NEAR, _above_near, spectral_line
from tests.diagnosis.series import coloured


def test_a_line_in_the_spectrum_is_told_from_a_smooth_one() -> None:
    rng, clock = np.random.default_rng(11), 0.1 * np.arange(400)
    still = [np.zeros((400, 1))]
    smooth = [[coloured(rng, 400, m)[:, None]] for m in (0.0, 0.5, 0.9) for _ in range(50)]
    assert not any(spectral_line(run, still).chance < 1e-8 for run in smooth)
    swing = np.sin(2.0 * np.pi * 0.5 * clock)[:, None]
    line = swing + 0.3 * coloured(rng, 400, 0.5)[:, None]
    found = spectral_line([line], still)
    assert found.chance < 1e-8 and abs(found.cycles / 0.1 - 0.5) < 0.5 / 40.0, found
    assert spectral_line([line], [swing + 0.1 * coloured(rng, 400, 0.5)[:, None]]).chance > 1e-8, "the drive swings so itself"


def test_a_spectrum_that_falls_onto_a_floor_has_no_line() -> None:
    """A cubic does not follow it."""
    rng, still = np.random.default_rng(5), np.zeros((300, 3))
    fall = butter(3, 0.2, output="sos")
    runs = [sosfilt(fall, rng.standard_normal((300, 3)), axis=0) + 0.01 * rng.standard_normal((300, 3)) for _ in range(60)]
    assert not any(spectral_line([run], [still]).chance < 1e-5 for run in runs)
    swing = 0.05 * np.sin(2.5 * np.arange(300))[:, None]
    assert spectral_line([runs[0] + swing], [still]).chance < 1e-8


def test_neighbours_are_taken_from_a_window_and_an_hour_of_bins_is_no_matter() -> None:
    height = np.random.default_rng(2).standard_normal(80)
    expected = [
        height[k] - np.median([height[j] for j in range(80) if NEAR <= abs(j - k) <= FAR]) + np.log(np.log(2.0))
        for k in range(80)
    ]
    np.testing.assert_allclose(_above_near(height), expected, rtol=0.0, atol=1e-14)
    hour = np.random.default_rng(3).standard_normal((36_000, 1))
    tracemalloc.start()
    spectral_line([hour], [np.zeros((36_000, 1))])
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1e8, most
