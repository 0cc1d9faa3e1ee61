"""A body whose modulus and frame are known is found again from a table of its tips."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.calibration.table_fit import body_map, fit_table
from softrl.core.errors import ConfigError


def bent(ratio: np.ndarray) -> np.ndarray:
    """Return tips (rows, 3) m of a made-up body by pressure over modulus."""
    angle = np.deg2rad([-90.0, 150.0, 30.0])
    pull = 1.5 * ratio @ np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.column_stack([-pull, 0.4 * ratio.sum(axis=1) - 5.0 * (pull**2).sum(axis=1) * np.tanh(1.0)])


def test_modulus_order_and_frame_are_found_again() -> None:
    rng = np.random.default_rng(0)
    sampled = rng.uniform(-3e4, 4e4, (40, 3))
    body, error = body_map(sampled, bent(sampled / 1.6e6), 1.6e6, 2)
    assert error < 1e-9
    pressure = rng.uniform(-2e4, 3e4, (200, 3))
    turn, origin = Rotation.from_rotvec([0.2, -0.4, 1.0]).as_matrix(), np.array([0.01, 0.02, 0.19])
    tip = bent(pressure[:, [0, 2, 1]] / 1.3e6) @ turn.T + origin
    fit = fit_table(body, pressure, tip, np.arange(200) % 2 == 0)
    assert fit.youngs_modulus_pa == pytest.approx(1.3e6, rel=1e-4)
    assert fit.heldout_rmse_m < 1e-6 < fit.still_rmse_m
    assert np.allclose(fit.origin_m, origin, atol=1e-5)


def test_a_reach_beyond_the_tip_is_told_from_a_softer_body() -> None:
    rng = np.random.default_rng(1)

    def turned(ratio: np.ndarray) -> np.ndarray:
        pull = bent(ratio)[:, :2]
        return np.column_stack([-12.0 * pull[:, 1], 12.0 * pull[:, 0], 0.0 * pull[:, 0]])

    sampled = rng.uniform(-3e4, 4e4, (60, 3))
    body, _ = body_map(sampled, bent(sampled / 1.6e6), 1.6e6, 3, turned(sampled / 1.6e6))
    pressure, ahead = rng.uniform(-2e4, 3e4, (200, 3)), np.array([0.0, 0.0, 0.03])
    swing = Rotation.from_rotvec(turned(pressure / 2e6)).apply(ahead)
    tip, train = bent(pressure / 2e6) + swing, np.arange(200) % 2 == 0
    plain, fit = (fit_table(body, pressure, tip, train, seek) for seek in (False, True))
    assert fit.reach_m == pytest.approx(0.03, rel=0.02) and fit.youngs_modulus_pa == pytest.approx(2e6, rel=0.01)
    assert fit.heldout_rmse_m < 0.1 * plain.heldout_rmse_m
    with pytest.raises(ConfigError, match="turns of the plate"):
        fit_table(body_map(sampled, bent(sampled / 1.6e6), 1.6e6, 2)[0], pressure, tip, train, True)


def test_too_few_equilibria_are_refused() -> None:
    with pytest.raises(ConfigError, match="degree=3 has 19 terms"):
        body_map(np.ones((10, 3)), np.ones((10, 3)), 1e6, 3)
