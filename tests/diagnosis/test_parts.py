"""A sensor's bias is told from what a valve's law does not quite get right."""

import numpy as np

from softrl.diagnosis.parts import _bias
from tests.diagnosis.series import coloured


def test_a_bias_is_taken_out_where_it_is_one_for_sure_only() -> None:
    rng = np.random.default_rng(0)
    white = 60.0 * rng.standard_normal((1500, 3)) + [300.0, -40.0, 0.0]
    np.testing.assert_allclose(_bias(white), [300.0, -40.0, 0.0], atol=6.0)
    slow = np.stack([800.0 * coloured(rng, 1500, 0.99) * np.sqrt(1.0 - 0.99**2) for _ in range(3)], axis=1)
    assert np.abs(slow.mean(axis=0)).max() > 50.0
    np.testing.assert_allclose(_bias(slow), 0.0, atol=30.0)
