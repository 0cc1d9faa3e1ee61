"""Noise of any colour passes, and jumps and errors that come with motion do not."""

import numpy as np
import pytest
from scipy.signal import lfilter

from softrl.diagnosis.series.moments import at_moments
from softrl.diagnosis.series.noise import unlike_noise
from softrl.diagnosis.series.statistics import follows
from tests.diagnosis.series import coloured


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9, 0.97, "mixed"])
@pytest.mark.parametrize(("runs", "length", "holds"), [(1, 120, 4), (2, 300, 20)])
def test_noise_of_any_colour_is_uneven_as_rarely_as_said(
    memory: float | str, runs: int, length: int, holds: int
) -> None:
    rng, alarms, shares = np.random.default_rng(16), 0, []
    for _ in range(60):
        edges = [np.sort(rng.integers(0, length, holds)) for _ in range(runs)]
        drives = [rng.uniform(size=(holds + 1, 2))[np.searchsorted(edge, np.arange(length))] for edge in edges]
        slow = [np.stack([coloured(rng, length, 0.9 if memory == "mixed" else memory) for _ in range(2)], axis=1)
                for _ in range(runs)]  # fmt: skip
        noise = [x + 2.0 * rng.standard_normal(x.shape) if memory == "mixed" else x for x in slow]
        found = unlike_noise(noise, drives, 39, rng)
        alarms += found.p_value <= 0.05
        shares.append(found.share)
    assert alarms <= 8, f"{alarms} of 60 false alarms at 5 %"
    assert np.median(shares) < 0.1, "noise has little power in excess"


def test_the_share_in_excess_is_that_of_the_jumps_and_of_what_comes_with_motion() -> None:
    rng = np.random.default_rng(17)
    drive = np.repeat(rng.uniform(size=(60, 1)), 20, axis=0)
    moves = np.abs(np.diff(drive, axis=0, prepend=drive[:1]))
    quiet, rough = rng.standard_normal((2, 1200, 2))
    with_motion = quiet + rough * np.sqrt(moves / moves.mean())
    assert unlike_noise([with_motion], [drive], 39, rng).share == pytest.approx(0.5, abs=0.12)
    jumps = np.sqrt(40.0) * rough * (np.arange(1200) % 40 == 7)[:, None]
    assert unlike_noise([quiet + jumps], [drive], 39, rng).share == pytest.approx(0.5, abs=0.12)


ONE_WAY = np.outer([1.0, 0.5, 0.3], [1.0, 0.0, 0.0]) + 0.01 * np.eye(3)


@pytest.mark.parametrize("mix", [np.eye(3), ONE_WAY, np.diag([1.0, 1.0, 0.0])])
def test_the_share_in_excess_is_the_same_whether_noise_points_all_ways_or_mainly_one(mix: np.ndarray) -> None:
    rng = np.random.default_rng(19)
    drive = np.repeat(rng.uniform(size=(120, 1)), 10, axis=0)
    quiet = [rng.standard_normal((1200, 3)) @ mix.T for _ in range(6)]
    assert unlike_noise(quiet, [drive] * 6, 39, rng).share < 0.08
    jumps = [rng.choice([-1.0, 1.0], (1200, 1)) * (np.arange(1200) % 40 == 7)[:, None] for _ in range(6)]
    struck = [run + np.sqrt(40.0) * run.std(axis=0) * jump for run, jump in zip(quiet, jumps, strict=True)]
    assert unlike_noise(struck, [drive] * 6, 39, rng).share == pytest.approx(0.5, abs=0.05)


def test_noise_is_told_from_jumps_and_from_what_comes_with_motion() -> None:
    rng = np.random.default_rng(13)
    drive = np.repeat(rng.uniform(size=(20, 1)), 15, axis=0)
    steps = np.diff(drive, axis=0, prepend=drive[:1])
    noise = coloured(rng, 300, 0.9)[:, None]
    jumped = noise + 8.0 * (np.arange(300) > 150)[:, None]
    assert unlike_noise([jumped], [drive], 200, rng).p_value < 0.02
    late = np.asarray(lfilter([1.0], [1.0, -0.7], np.abs(steps[:, 0]) * rng.standard_normal(300)))[:, None]
    assert unlike_noise([0.2 * noise + 20.0 * late], [drive], 200, rng).p_value < 0.02


def test_what_parameters_a_little_off_leave_is_no_structure() -> None:
    rng = np.random.default_rng(15)
    drive = np.repeat(rng.uniform(size=(20, 1)), 15, axis=0)
    slope = np.asarray(lfilter([1.0], [1.0, -0.8], np.abs(np.diff(drive, axis=0, prepend=drive[:1])), axis=0))
    slow = [coloured(rng, 300, 0.98)[:, None] for _ in range(2)]
    off = [noise + 3.0 * slope for noise in slow]
    assert unlike_noise(off, [drive, drive], 200, rng).p_value < 0.02
    assert unlike_noise(off, [drive, drive], 200, rng, [slope[:, :, None]] * 2).p_value > 0.05
    rough = [noise + 3.0 * slope * rng.standard_normal((300, 1)) for noise in slow]
    assert unlike_noise(rough, [drive, drive], 200, rng, [slope[:, :, None]] * 2).p_value < 0.02


def test_what_waits_for_a_first_command_is_no_noise() -> None:
    rng = np.random.default_rng(18)
    drive = np.cumsum(rng.standard_normal((300, 2)), axis=0)
    drive[:20] = drive[20]  # the robot stands, then moves without a pause and always alike
    drive[20:] = drive[20] + np.cumsum(np.sign(rng.standard_normal((280, 2))), axis=0)
    noise = rng.standard_normal((300, 3))
    assert unlike_noise([noise, noise[::-1]], [drive, drive], 200, rng).p_value > 0.05
    found = unlike_noise([noise * np.where(np.arange(300) < 20, 0.2, 1.0)[:, None]] * 2, [drive, drive], 200, rng)
    assert found.p_value < 0.02
    assert found.share > 0.8


@pytest.mark.parametrize("rows", range(2, 12))
def test_a_run_of_few_rows_beside_long_ones_changes_nothing(rows: int) -> None:
    """A table of poses may have some, beside others whose noise remembers eight rows; alone they tell nothing."""
    rng = np.random.default_rng(20)
    long = [np.asarray(lfilter([1.0], [1.0, *7 * [0.0], -0.6], rng.standard_normal((300, 3)), axis=0)) for _ in range(3)]
    runs = [*long, rng.standard_normal((rows, 3))]
    drives = [rng.standard_normal((len(run), 2)) for run in runs]
    found = unlike_noise(runs, drives, 39, rng, [run[:, :, None] * rng.standard_normal((len(run), 1, 1)) for run in runs])
    assert found.p_value > 0.05 and found.share < 0.1
    assert at_moments(runs, 1e-3) == 0.0
    assert follows([run[:, 0] for run in runs], [drive[:, 0] for drive in drives], 10)[1] > 0.01
    few = [run[:6] for run in runs]
    assert unlike_noise(few, [drive[:6] for drive in drives], 39, rng) == (1.0, 0.0) and at_moments(few, 1e-3) == 0.0
