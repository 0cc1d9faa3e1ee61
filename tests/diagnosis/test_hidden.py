"""What a calibrated map has absorbed is read off it, chamber by chamber."""

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.diagnosis.judging.hidden import in_words, read_map


def linear_map(gain: np.ndarray, shift_pa: np.ndarray) -> Calibration:
    """A map without hidden layers' work: ``P_S = gain P_R + shift`` by its linear skip alone."""
    n, low, high = len(gain), np.full(len(gain), -2e4), np.full(len(gain), 3.5e4)
    spread, size = 1e4, 1e3
    return Calibration(
        weights={
            "skip": ((gain - 1.0)[:, None] * np.eye(n) * spread / size)[None],
            "bias": (shift_pa / size)[None],
            "weight_0": np.zeros((1, n, 1)),
            "bias_0": np.zeros((1, 1)),
            "weight_1": np.zeros((1, 1, 1)),
            "bias_1": np.zeros((1, 1)),
            "weight_2": np.zeros((1, 1, n)),
        },
        members=1,
        pressure_mean=np.zeros(n),
        pressure_spread=np.full(n, spread),
        correction_spread=np.full(n, size),
        pressure_low=low,
        pressure_high=high,
        pressure_real=np.zeros((1, n)),
        pressure_sim=np.zeros((1, n)),
        heldout=np.zeros(1, dtype=bool),
        inverted_by="simulator",
        material={},
        robot_name="tripod",
    )


def test_gain_and_offset_are_read_in_their_chamber() -> None:
    rows = read_map(linear_map(np.array([1.0, 0.8, 1.0]), np.array([0.0, 0.0, 2e3])))
    np.testing.assert_allclose([row["gain"] for row in rows], [1.0, 0.8, 1.0], atol=1e-6)
    np.testing.assert_allclose([row["offset_kpa"] for row in rows], [0.0, 0.0, 2.0], atol=1e-6)
    lines = in_words(rows)
    assert len(lines) == 2 and "chamber 2 scales the pressure by 0.8" in lines[0] and "shifts it by 2 kPa" in lines[1]


def test_an_identity_has_absorbed_nothing() -> None:
    assert "absorbed nothing" in in_words(read_map(linear_map(np.ones(3), np.zeros(3))))[0]


def test_nothing_is_read_of_a_chamber_that_was_not_driven() -> None:
    still = linear_map(np.array([1.0, 0.8, 1.0]), np.zeros(3))
    still.pressure_low[2] = still.pressure_high[2] = 0.0
    assert [row["chamber"] for row in read_map(still)] == [1, 2]
