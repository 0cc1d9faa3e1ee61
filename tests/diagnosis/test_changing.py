"""What follows the pressures now this way, now that way is told from noise of any colour."""

import numpy as np
import pytest

from softrl.diagnosis.series.changing import follows_at_times
from tests.diagnosis.series import coloured

WINDOW = 60


def drives(rng: np.random.Generator) -> list[np.ndarray]:
    return [np.repeat(rng.uniform(size=(50, 3)), 6, axis=0) for _ in range(2)]


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_noise_follows_pressures_as_rarely_as_said(memory: float) -> None:
    rng, alarms = np.random.default_rng(3), 0
    for _ in range(40):
        mix = rng.standard_normal((3, 3))
        noise = [np.stack([coloured(rng, 300, memory) for _ in range(3)], axis=1) @ mix for _ in range(2)]
        alarms += follows_at_times(noise, drives(rng), WINDOW, 39, rng).p_value <= 0.05
    assert alarms <= 6, f"{alarms} of 40 false alarms at 5 %"


def test_a_gain_that_comes_and_goes_is_found_with_its_share() -> None:
    rng, found = np.random.default_rng(4), []
    swing = np.sin(2.0 * np.pi * np.arange(300) / 130)[:, None]
    pressed = drives(rng)
    for size in (0.0, 0.3):
        moved = [swing * (drive - drive.mean(axis=0)) @ rng.standard_normal((3, 3)) for drive in pressed]
        left = [size * m / m.std() + 0.3 * rng.standard_normal(m.shape) for m in moved]
        found.append(follows_at_times(left, pressed, WINDOW, 199, rng))
    assert found[0].p_value > 0.05
    assert found[1].p_value < 0.01 and found[1].share == pytest.approx(0.45, abs=0.2)


def test_of_too_few_rows_to_tell_anything_no_share_is_made_up() -> None:
    """Of two rows the pressures explain all, in noise too: rounding over rounding came out as 1e285."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        found = follows_at_times([rng.standard_normal((2, 3))], [rng.uniform(size=(2, 3))], WINDOW, 19, rng)
        assert 0.0 <= found.share <= 1.0 and found.p_value > 0.05
