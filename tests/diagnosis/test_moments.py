"""A few moments that are none of the noise are seen, however short; noise of any memory has none at the level told."""

import numpy as np
from scipy.signal import lfilter

from softrl.diagnosis.series.moments import at_moments


def noise(rng: np.random.Generator, memory: float, steps: int = 300) -> np.ndarray:
    mix = rng.standard_normal((3, 3))
    return np.asarray(lfilter([1.0], [1.0, -memory], rng.standard_normal((steps, 3)) @ mix, axis=0))


def test_noise_of_any_memory_has_a_moment_as_often_as_the_level_says() -> None:
    rng, level = np.random.default_rng(1), 0.1
    found = [at_moments([noise(rng, memory) for _ in range(2)], level) for memory in 60 * [0.0, 0.6, 0.95]]
    assert 0.05 < np.mean(np.array(found) > 0.0) < 0.18


def test_a_planar_robot_has_a_moment_in_noise_no_oftener_and_those_that_are_there() -> None:
    rng, level = np.random.default_rng(6), 0.1
    flat = np.diag([1.0, 1.0, 0.0])
    found = [at_moments([noise(rng, memory) @ flat for _ in range(2)], level) for memory in 60 * [0.0, 0.6, 0.95]]
    assert 0.05 < np.mean(np.array(found) > 0.0) < 0.18
    struck = rng.standard_normal((300, 3)) @ flat
    struck[100] = 12.0, -12.0, 0.0
    assert abs(at_moments([struck], 0.001) - 288.0 / (288.0 + 600.0)) < 0.1
    assert at_moments([np.zeros((300, 3))], 0.001) == 0.0


def test_moments_hold_their_share_of_the_power_wherever_they_come() -> None:
    rng = np.random.default_rng(2)
    quiet = [rng.standard_normal((300, 3)) for _ in range(2)]
    for many in (4, 20):
        seen = [run.copy() for run in quiet]
        for run in seen:
            run[rng.choice(300, many, replace=False)] += 12.0 * rng.choice([-1.0, 1.0], (many, 3))
        added = 3 * 144.0 * many
        assert abs(at_moments(seen, 0.001) - added / (added + 900.0)) < 0.1


def test_what_comes_with_every_motion_is_no_moment() -> None:
    rng = np.random.default_rng(3)
    drive = np.sin(np.arange(300) / 7.0)[:, None]
    runs = [0.3 * rng.standard_normal((300, 3)) + drive**2 * rng.standard_normal((300, 3)) for _ in range(2)]
    assert at_moments(runs, 0.001) < 0.15


def test_a_louder_run_is_no_moment() -> None:
    rng = np.random.default_rng(4)
    assert at_moments([noise(rng, 0.5), 5.0 * noise(rng, 0.5)], 0.001) < 0.02
