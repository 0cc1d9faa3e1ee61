"""Laws of whitening: unit variance in every direction that varies, none where nothing does."""

import numpy as np

from softrl.core.whitening import Whitener


def test_every_direction_that_varies_has_unit_variance() -> None:
    rng = np.random.default_rng(0)
    plain = rng.normal(size=(200, 3)) * [1.0, 1e-3, 50.0] + [3.0, 0.0, -7.0]
    values = np.column_stack([plain, plain @ [1.0, 200.0, 0.1], np.full(200, 2.0)])  # one that follows, one that is still
    white = Whitener.fit(values).whiten(values)
    assert white.shape == (200, 3)
    np.testing.assert_allclose(white.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(white.T @ white / 200, np.eye(3), atol=1e-9)


def test_scaling_leaves_the_features_themselves() -> None:
    values = np.random.default_rng(1).normal(size=(50, 3)) * [1.0, 5.0, 0.0] + 4.0
    white = Whitener.scaling(values).whiten(values)
    np.testing.assert_allclose(white.std(axis=0), [1.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.corrcoef(white[:, 0], values[:, 0])[0, 1], 1.0)
