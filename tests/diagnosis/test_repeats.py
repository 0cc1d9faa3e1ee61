"""What comes again with a pressure, however finely it depends on it, is told from noise of any colour."""

import numpy as np
import pytest

from softrl.diagnosis.series.repeats import repeats
from tests.diagnosis.series import coloured


def drives(rng: np.random.Generator, steps: int = 300) -> list[np.ndarray]:
    place = np.linspace(0.0, 1.0, steps)
    return [
        np.stack([0.5 + 0.5 * np.sin(2.0 * np.pi * (rng.uniform(2, 5) * place + rng.uniform())) for _ in range(2)], axis=1)
        for _ in range(3)
    ]


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_noise_comes_again_as_rarely_as_said(memory: float) -> None:
    rng, alarms = np.random.default_rng(3), 0
    for _ in range(40):
        noise = [np.stack([coloured(rng, 300, memory) for _ in range(2)], axis=1) for _ in range(3)]
        alarms += repeats(noise, drives(rng), 39, rng).p_value <= 0.05
    assert alarms <= 6, f"{alarms} of 40 false alarms at 5 %"


def test_noise_along_one_line_comes_again_as_rarely_whichever_way_that_lies() -> None:
    rng, alarms = np.random.default_rng(3), 0
    for _ in range(60):
        noise = [coloured(rng, 300, 0.5)[:, None] @ np.ones((1, 3)) for _ in range(3)]
        alarms += repeats(noise, drives(rng), 39, rng).p_value <= 0.05
    assert alarms <= 7, f"{alarms} of 60 false alarms at 5 %"


def test_the_steps_of_a_coarse_regulator_are_found_in_the_channel_that_has_them() -> None:
    rng, found = np.random.default_rng(4), []
    for size in (0.0, 1.0):
        pressed = drives(rng)
        steps = [(drive[:, 1] * 12 + 0.5) % 1.0 - 0.5 for drive in pressed]
        left = [0.2 * rng.standard_normal((300, 2)) + size * np.stack([step, 0.0 * step], axis=1) for step in steps]
        found.append(repeats(left, pressed, 199, rng))
    assert found[0].p_value > 0.05
    assert found[1].p_value < 0.01
    assert 0.3 < found[1].share < (1 / 12) / (1 / 12 + 2 * 0.04)  # levels are wide, and few samples are at each
