"""f_RS: NumPy equals the trained network, its slope is right, its inverse exact, and the identity its prior."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from softrl.artifacts.calibration import Calibration
from softrl.calibration.mlp import EnsembleSettings, fit_ensemble, forward
from softrl.calibration.pressure_map import PressureMap
from softrl.calibration.report import report_map
from softrl.core.errors import SolverError
from softrl.core.tracking import NullTracker

SETTINGS = EnsembleSettings(members=3, hidden=8, epochs=800, learning_rate=0.01, weight_decays=(1e-6,), seed=5)


def bent(pressure: np.ndarray) -> np.ndarray:
    """Return a smooth monotone map that mixes the chambers."""
    mixed = pressure @ np.array([[0.9, 0.02, 0.0], [0.0, 1.05, 0.03], [0.02, 0.0, 0.95]])
    return mixed + 800.0 * np.tanh(pressure / 12e3) + 200.0


def calibration_of(sim: np.ndarray, real: np.ndarray, settings: EnsembleSettings = SETTINGS) -> Calibration:
    ensemble = fit_ensemble(real, sim, settings)
    return Calibration(
        ensemble.weights, settings.members, ensemble.pressure.mean, ensemble.pressure.spread,
        ensemble.correction_spread, real.min(axis=0), real.max(axis=0), real, sim, np.zeros(len(real), dtype=bool),
        "simulator", {}, "triple",
    )  # fmt: skip


@pytest.fixture(scope="module")
def real() -> np.ndarray:
    return np.random.default_rng(0).uniform(-20e3, 35e3, (90, 3))


@pytest.fixture(scope="module")
def calibration(real: np.ndarray) -> Calibration:
    return calibration_of(bent(real), real)


def test_map_beats_identity_and_affine_on_unseen_pressures(calibration: Calibration, real: np.ndarray) -> None:
    unseen = np.random.default_rng(1).uniform(-18e3, 33e3, (200, 3))
    error = np.sqrt(np.mean((PressureMap(calibration).real_to_sim(unseen) - bent(unseen)) ** 2))
    ones = np.ones((len(real), 1))
    affine = np.linalg.lstsq(np.hstack([real, ones]), bent(real), rcond=None)[0]
    affine_error = np.sqrt(np.mean((np.hstack([unseen, np.ones((200, 1))]) @ affine - bent(unseen)) ** 2))
    assert error < 60.0, f"f_RS is off by {error:.0f} Pa"
    assert error < 0.5 * affine_error, f"{error:.0f} Pa against {affine_error:.0f} Pa of the affine map"


def test_numpy_map_equals_the_trained_network(calibration: Calibration, real: np.ndarray) -> None:
    scaled = torch.tensor((real - calibration.pressure_mean) / calibration.pressure_spread)
    by_torch = forward({k: torch.tensor(w) for k, w in calibration.weights.items()}, scaled).mean(dim=0).numpy()
    by_numpy = PressureMap(calibration).real_to_sim(real) - real
    np.testing.assert_allclose(by_numpy, by_torch * calibration.correction_spread, atol=1e-8)


def test_slope_is_that_of_finite_differences(calibration: Calibration, real: np.ndarray) -> None:
    pressure_map, rows, h = PressureMap(calibration), 0.9 * real[:5], 1.0
    slope = pressure_map._corrections(rows)[1].mean(axis=0)
    for j in range(3):
        shift = h * np.eye(3)[j]
        difference = (pressure_map.real_to_sim(rows + shift) - pressure_map.real_to_sim(rows - shift)) / (2 * h)
        np.testing.assert_allclose(np.eye(3)[:, j] + slope[:, :, j], difference, atol=1e-6)


def test_inverse_is_exact_inside_and_outside_of_the_trained_range(calibration: Calibration) -> None:
    pressure = np.random.default_rng(2).uniform(-40e3, 60e3, (300, 3))
    pressure_map = PressureMap(calibration)
    np.testing.assert_allclose(pressure_map.sim_to_real(pressure_map.real_to_sim(pressure)), pressure, atol=0.01)
    np.testing.assert_allclose(pressure_map.sim_to_real(pressure_map.real_to_sim(pressure[0])), pressure[0], atol=0.01)


def test_a_map_that_folds_has_no_inverse_and_is_reported_all_the_same(
    real: np.ndarray, caplog: pytest.LogCaptureFixture
) -> None:
    """Commands above a supply's end bring no more about: what else there is to say of the map is said."""
    sim, tracker = real - 1.6 * np.maximum(real - 12e3, 0.0), NullTracker()
    made = replace(calibration_of(sim, real, replace(SETTINGS, epochs=400)), heldout=np.arange(len(real)) % 4 == 0)
    report_map(made, tracker)
    none = tracker.metrics["heldout/pressure_map_without_inverse_pct"]
    assert 0.0 < none < 100.0 and 0.0 < tracker.metrics["heldout/pressure_map_inverse_rms_kpa"]
    assert f"f_RS has no inverse at {round(1e-2 * none * made.heldout.sum())} of 23 held-out holds" in caplog.text


def test_identity_is_the_prior(real: np.ndarray) -> None:
    none = calibration_of(real, real)
    np.testing.assert_allclose(PressureMap(none).real_to_sim(real), real, atol=1e-3)


def test_more_members_than_holds_take_nothing_away_from_the_map(real: np.ndarray) -> None:
    """A regulator that is off by 1 kPa is so whatever the size of the ensemble; that of the identity was mixed in before."""
    few = real[:8]
    found = PressureMap(calibration_of(few + 1e3, few, replace(SETTINGS, members=12, epochs=1500, weight_decays=(0.1, 1e-4))))
    np.testing.assert_allclose(found.real_to_sim(few) - few, 1e3, atol=50.0)
    assert found.spread(few).max() < 50.0


def test_members_disagree_more_where_they_have_no_data(real: np.ndarray) -> None:
    low = real[real.sum(axis=1) < 20e3]
    spread = PressureMap(calibration_of(bent(low), low)).spread
    assert np.mean(spread(np.full((1, 3), low.max()))) > 2.0 * np.mean(spread(low))


def test_training_is_deterministic(real: np.ndarray) -> None:
    first, second = (fit_ensemble(real, bent(real), SETTINGS).weights for _ in range(2))
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])


def test_a_folded_map_is_refused_with_the_remedy(calibration: Calibration) -> None:
    weights = {name: np.zeros_like(w) for name, w in calibration.weights.items()}
    # P_S = P_R - P_R + const: no P_R gives another P_S
    weights["skip"] = -np.tile(np.diag(calibration.pressure_spread / calibration.correction_spread), (3, 1, 1))
    fields = vars(calibration) | {
        "weights": weights,
        "pressure_low": np.full(3, -1e9),
        "pressure_high": np.full(3, 1e9),
    }
    with pytest.raises(SolverError, match=r"raise stage\.weight_decays"):
        PressureMap(Calibration(**fields)).sim_to_real(np.full((1, 3), 5e3))
