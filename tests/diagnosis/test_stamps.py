"""Whether rows came when their stamps say, or evenly, is read off the motion; nothing else changes the times of a log."""

import numpy as np
import pytest

from softrl.diagnosis.checks.stamps import even_clock, evened
from softrl.recordings.recording import Recording

PERIOD_S, ROWS = 0.02, 1500


def moved(time: np.ndarray) -> np.ndarray:
    """Return a motion (steps, 3) m of several frequencies."""
    return np.stack([0.03 * np.sin(2 * np.pi * f * time + f) for f in (0.7, 1.1, 1.6)], axis=1)


def log(seed: int, jitter_s: float, truly: bool, lost: float = 0.01, offset_s: float = 3.0) -> tuple[Recording, np.ndarray]:
    """Return a run whose stamps jitter, ``truly`` or only in the log, and when its rows were taken."""
    rng = np.random.default_rng(seed)
    kept = rng.random(ROWS) >= lost
    even = offset_s + PERIOD_S * np.arange(ROWS)[kept]
    stamps = np.maximum.accumulate(even + np.clip(jitter_s * rng.standard_normal(len(even)), -0.4 * PERIOD_S, 0.4 * PERIOD_S))
    taken = stamps if truly else even
    position = moved(taken) + 1e-4 * rng.standard_normal((len(even), 3))
    return Recording(f"run_{seed}", "day", stamps, np.zeros((len(even), 3)), position=position), taken


@pytest.mark.parametrize("jitter_s", [0.001, 0.003])
def test_rows_come_evenly_where_only_stamps_jitter(jitter_s: float) -> None:
    runs, taken = zip(*(log(seed, jitter_s, False) for seed in range(4)), strict=True)
    found, lines = evened(runs)
    assert len(lines) == 1 and "even clock" in lines[0]
    for run, truth in zip(found, taken, strict=True):
        assert np.std(run.time - truth) < 0.25 * jitter_s
        assert abs(np.mean(run.time - truth)) < 0.1 * jitter_s


def test_rows_that_came_when_they_say_keep_their_times() -> None:
    runs = [log(seed, 0.002, True)[0] for seed in range(4)]
    found, lines = evened(runs)
    assert not lines
    assert all(a is b for a, b in zip(found, runs, strict=True))


def test_a_log_without_jitter_and_one_without_a_clock_keep_their_times() -> None:
    rng = np.random.default_rng(0)
    punctual = log(0, 0.0, False)[0]
    time = np.cumsum(rng.exponential(PERIOD_S, ROWS))
    anyhow = Recording("any", "day", time, np.zeros((ROWS, 3)), position=moved(time))
    assert even_clock(punctual.time) is None and even_clock(anyhow.time) is None
    assert not evened([punctual, anyhow])[1]


def test_a_clock_that_wanders_is_followed() -> None:
    ticks = PERIOD_S * np.arange(ROWS) + 0.05 * np.sin(np.arange(ROWS) / 300.0)
    stamps = ticks + 0.001 * np.random.default_rng(0).standard_normal(ROWS)
    even = even_clock(stamps)
    assert even is not None and np.std(even - ticks) < 0.0004


def test_a_sensor_slower_than_the_rows_tells_nothing_of_them() -> None:
    run, _ = log(0, 0.002, False)
    assert run.position is not None
    held = run.position[np.arange(len(run.time)) // 3 * 3]
    slow = Recording("slow", "day", run.time, run.pressure_cmd, position=held)
    assert not evened([slow] * 3)[1]
