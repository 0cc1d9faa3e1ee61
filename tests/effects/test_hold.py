"""A camera runs freely: when it is read is found in every recording, whatever its period was doing when that began."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.identity import Same
from softrl.effects.chain import Plant, chain_of
from softrl.effects.hold import Hold, reading_period, reading_phase
from softrl.effects.replay import replay
from softrl.recordings.recording import Recording
from tests.effects.test_replay import ROBOT, Wire

NOISE_M = 1e-4
ROWS_S = 0.02


def moved(seen: np.ndarray, run: int = 0) -> np.ndarray:
    """Return a motion (steps, 3) m at the times ``seen`` (steps,) s."""
    return 0.02 * np.sin(2.0 * np.pi * np.outer(seen, (0.9, 0.53, 0.37)) + run)


def recording(
    period_s: float,
    phase_s: float,
    *,
    run: int = 0,
    seconds: float = 30.0,
    uneven_s: float = 0.0,
    shaken_s: float = 0.0,
    late_s: float = 0.0,
    begins_s: float = 0.0,
) -> Recording:
    """Return a run at 50 rows a second of a motion that a slow camera saw, and the pressures that make it, 1 Pa for each um.

    Its rows are uneven by ``uneven_s``, its frames ``shaken_s`` early or late, and they reach the log after ``late_s``.
    """
    rng = np.random.default_rng(run)
    time = ROWS_S * np.arange(round(seconds / ROWS_S)) + uneven_s * rng.uniform(0.0, 1.0, round(seconds / ROWS_S))
    time += begins_s - time[0]
    frames = begins_s + phase_s + period_s * np.arange(-3, int(seconds / period_s) + 3)
    frames += shaken_s * rng.uniform(-1.0, 1.0, len(frames))
    taken = frames[np.searchsorted(frames + late_s, time + 1e-9, side="right") - 1]
    seen = moved(taken, run) + NOISE_M * rng.standard_normal((len(time), 3))
    pressure = 1e6 * moved(time, run)
    return Recording(f"run_{run}", "day", time, pressure, pressure_meas=pressure, position=seen)


def series(runs: list[Recording]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(run.time, np.asarray(run.position)) for run in runs]


def apart(found_s: float, phase_s: float, period_s: float) -> float:
    """Return how much later than a phase another is, s, where whole periods do not count."""
    return float((found_s - phase_s + 0.5 * period_s) % period_s - 0.5 * period_s)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("period_s", [0.05, 0.08, 1.0 / 12.0, 0.4])
@pytest.mark.parametrize("fault", [{}, {"uneven_s": 2e-3}, {"shaken_s": 4e-3}, {"late_s": 0.033}])
def test_a_period_is_found_wherever_in_it_runs_begin(seed: int, period_s: float, fault: dict[str, float]) -> None:
    rng = np.random.default_rng(seed)
    runs = [recording(period_s, period_s * rng.uniform(), run=k, **fault) for k in range(4)]
    found = reading_period(series(runs))
    assert found is not None and abs(found - period_s) < max(1e-4, 0.6 * ROWS_S * period_s / 30.0), found
    alone = reading_period(series(runs[:1]))
    assert alone is not None and abs(alone - period_s) < max(1e-4, ROWS_S * period_s / 30.0), alone


@pytest.mark.parametrize("period_s", [0.033, 1.0 / 12.0, 0.117, 0.413])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.55, 0.97])
@pytest.mark.parametrize("fault", [{}, {"uneven_s": 2e-3}, {"shaken_s": 4e-3}, {"late_s": 0.013}])
def test_a_phase_is_read_off_the_recording(period_s: float, share: float, fault: dict[str, float]) -> None:
    run = recording(period_s, share * period_s, run=3, begins_s=100.0, **fault)
    found = apart(reading_phase(Same(run), period_s).latest_s, share * period_s + fault.get("late_s", 0.0), period_s)
    assert -0.15 * ROWS_S < found < 0.4 * ROWS_S, found


@pytest.mark.parametrize("phase_s", [0.0, 0.013, 0.04, 0.071])
def test_readings_that_keep_pace_with_the_rows_fall_on_the_row_that_shows_them(phase_s: float) -> None:
    run = recording(0.08, phase_s)
    first = ROWS_S * np.ceil(phase_s / ROWS_S - 1e-9)
    assert abs(apart(reading_phase(Same(run), 0.08).latest_s, first, 0.08)) < 1e-6
    later = [reading_phase(Same(run), 0.08 + 1e-6 * k).latest_s for k in range(-5, 6)]
    assert np.abs(np.diff(later)).max() < 1e-6 * 30.0 / 0.08 + 1e-9, "a fit moves the period by less than shows"


def test_nothing_is_read_off_a_quick_sensor_nor_where_nothing_was_measured() -> None:
    time = ROWS_S * np.arange(1500)
    step = np.repeat(np.random.default_rng(5).uniform(size=(30, 3)), 50, axis=0)  # a command every second
    slow = np.array(
        [step[max(k - 100, 0) : k + 1][::-1].T @ np.exp(-np.arange(min(k, 100) + 1) / 4.0) for k in range(1500)]
    )
    for seen in (moved(time), slow / 4.0):
        noisy = seen + NOISE_M * np.random.default_rng(1).standard_normal(seen.shape)
        quick = Recording("run", "day", time, step, position=noisy)
        assert reading_period(series([quick, replace(quick, time=time + 3.0)])) is None
        for period_s in (0.08, 0.15, 0.4, 1.0):
            assert reading_phase(Same(quick), period_s) == (0.0, 0.0)
    assert reading_phase(Same(Recording("run", "day", time, step)), 0.08) == (0.0, 0.0)


@pytest.mark.parametrize("period_s", [0.08, 0.083])
def test_a_replay_is_read_when_the_recording_was(period_s: float) -> None:
    for k, share in enumerate(np.random.default_rng(8).uniform(size=4)):
        run = recording(period_s, share * period_s, run=k)
        plant = Plant(Wire(ROBOT), chain_of(ROBOT, (Hold(period_s=period_s),)))
        unasked = replace(run, pressure_cmd=np.zeros_like(run.pressure_cmd))  # no command tells how the pressures went
        made = np.asarray(replay(plant, unasked, 0.005, "measured").position)
        left = np.asarray(run.position)[10:] - 1e-6 * made[10:]
        swift = float(np.abs(np.gradient(moved(run.time, k), run.time, axis=0)).max())
        off = np.abs(left).max(axis=1) > 5.0 * NOISE_M + swift * 0.05 * ROWS_S
        assert off.mean() <= (0.0 if period_s == 0.08 else 0.005), "a reading near a row may come a row later"
        jumps = np.linalg.norm(np.diff(made, axis=0), axis=1) > 0.0
        taken = np.floor((run.time - share * period_s) / period_s + 1e-9)
        wrong = np.count_nonzero(jumps != (np.diff(taken) > 0.0))
        assert wrong <= (0 if period_s == 0.08 else 0.02 * np.count_nonzero(jumps))


def test_the_part_behind_a_gap_has_a_phase_of_its_own() -> None:
    run = recording(0.08, 0.0, seconds=60.0)
    later = {name: values[1001:] for name, values in run.channels()}
    behind = replace(run, **later)
    assert abs(apart(reading_phase(Same(run), 0.08).latest_s, 0.0, 0.08)) < 1e-6
    assert abs(apart(reading_phase(Same(behind), 0.08).latest_s, 0.06, 0.08)) < 1e-6


def test_without_a_measured_motion_readings_count_from_the_first_sample() -> None:
    run = recording(0.08, 0.05)
    plant = Plant(Wire(ROBOT), chain_of(ROBOT, (Hold(period_s=0.08),)))
    made = replay(plant, replace(run, position=None), 0.005).position
    assert made is not None
    np.testing.assert_allclose(made[:-3:4], made[3::4])


@pytest.mark.parametrize("period_s", [0.2, 0.3, 0.5])
@pytest.mark.parametrize("step_s", [2.4, 3.0])
def test_a_sensor_that_repeats_itself_is_not_taken_for_the_steps_that_it_sees(period_s: float, step_s: float) -> None:
    runs = []
    for number in range(3):
        blank = recording(ROWS_S, 0.0, run=number)
        frames = period_s * (np.arange(200) + 0.37 * number - 1.0)
        levels = np.random.default_rng(number).uniform(-0.02, 0.02, (100, 3))
        begun = np.maximum(frames, 0.0) // step_s
        settled = np.exp(-(np.maximum(frames, 0.0) - begun * step_s) / 0.2)[:, None]
        before = levels[np.maximum(begun.astype(int) - 1, 0)]
        seen = levels[begun.astype(int)] * (1.0 - settled) + before * settled
        seen += NOISE_M * np.random.default_rng(number).standard_normal(seen.shape)
        runs.append(replace(blank, position=seen[np.searchsorted(frames, blank.time + 1e-9, side="right") - 1]))
    found = reading_period(series(runs))
    assert found is not None and abs(found - period_s) < 2e-3, found
