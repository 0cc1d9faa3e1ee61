"""Laws of the moving average."""

import numpy as np
import pytest

from softrl.core.errors import ConfigError
from softrl.rl.filter import MovingAverage, moving_average


def test_a_constant_passes_unchanged_from_the_first_value() -> None:
    np.testing.assert_allclose(moving_average(np.full((7, 2), 3.5), 4), 3.5)


def test_a_ramp_lags_by_half_the_window() -> None:
    ramp = np.arange(20.0)[:, None]
    lag = ramp - moving_average(ramp, 5)
    np.testing.assert_allclose(lag[4:], 2.0)


def test_white_noise_loses_the_root_of_the_window() -> None:
    noise = np.random.default_rng(0).standard_normal((20000, 1))
    assert moving_average(noise, 4).std() == pytest.approx(0.5, rel=0.03)


def test_a_window_of_one_is_the_identity_and_none_is_refused() -> None:
    values = np.random.default_rng(1).standard_normal((5, 3))
    np.testing.assert_array_equal(moving_average(values, 1), values)
    with pytest.raises(ConfigError, match="average_window=0"):
        MovingAverage(0)


def test_it_keeps_its_own_copy_of_what_it_was_given() -> None:
    average, value = MovingAverage(2), np.ones(2)
    average.advance(value)
    value[:] = 100.0
    np.testing.assert_array_equal(average.advance(np.ones(2)), np.ones(2))
