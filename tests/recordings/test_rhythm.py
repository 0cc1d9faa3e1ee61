"""A log that is written more slowly for a while is told from one that loses rows."""

import numpy as np
import pytest

from softrl.recordings.rhythm import periods


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_rows_that_are_lost_leave_the_period_what_it_is(share: float) -> None:
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(5000)
    time = time[rng.random(5000) > share * (time > 50.0)]
    time = np.delete(time, slice(1000, 1400)) + 1e-4 * rng.standard_normal(len(time) - 400)
    np.testing.assert_allclose(periods(np.diff(time)), 0.02, rtol=0.01)


def test_stretches_of_other_periods_keep_theirs() -> None:
    apart = np.r_[np.full(200, 0.02), np.full(40, 0.2), 0.4, np.full(40, 0.2), np.full(200, 0.02), np.full(6, 1.0)]
    expected = np.where(apart == 0.4, 0.2, apart)
    np.testing.assert_array_equal(periods(apart), expected)


def test_a_few_intervals_say_little() -> None:
    np.testing.assert_array_equal(periods(np.array([0.1, 0.1, 5.0])), 0.1)
    assert len(periods(np.zeros(0))) == 0
