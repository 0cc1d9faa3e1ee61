"""Response times read from steps are those of the system that made them."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.diagnosis.checks.response import rise_time, step_responses
from softrl.recordings.recording import Recording


def stepped(fill_s: float, vent_s: float) -> Recording:
    """A chamber that fills and vents with its own time constants, sampled unevenly; the motion follows it at once."""
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.01, 0.03, 3000))
    command = np.where((time // 10.0) % 2 == 1, 50e3, 0.0)
    pressure = np.zeros_like(time)
    for k in range(1, len(time)):
        tau = fill_s if command[k] > pressure[k - 1] else vent_s
        pressure[k] = command[k] + (pressure[k - 1] - command[k]) * np.exp(-(time[k] - time[k - 1]) / tau)
    noisy = pressure + rng.normal(0.0, 100.0, len(time))
    position = np.outer(pressure, [1e-6, 0.0, -2e-7])
    return Recording("run", "day", time, command[:, None], noisy[:, None], position)


@pytest.mark.parametrize(("fill_s", "vent_s"), [(0.4, 0.4), (0.84, 1.46)])
def test_a_first_order_response_has_done_63_percent_after_its_time_constant(fill_s: float, vent_s: float) -> None:
    found = step_responses([stepped(fill_s, vent_s)])
    assert found.steps >= 5
    assert found.pressure_fill_s == pytest.approx(fill_s, rel=0.06)
    assert found.pressure_vent_s == pytest.approx(vent_s, rel=0.06)
    assert found.motion_fill_s == pytest.approx(fill_s, rel=0.06)
    assert "0.4" in found.sentence() or "0.8" in found.sentence()


def test_a_channel_that_does_not_move_gives_no_time() -> None:
    noise = np.random.default_rng(1).normal(size=(200, 1))
    assert rise_time(np.arange(200.0), noise) is None


def test_no_steps_no_sentence() -> None:
    time = np.arange(0.0, 5.0, 0.01)
    wave = 1e3 * np.sin(time)[:, None]
    found = step_responses([Recording("run", "day", time, wave, wave)])
    assert found.steps == 0 and found.sentence() is None


@pytest.mark.parametrize(
    ("limited", "expected", "word"), [(False, 1.0, "much as with a lag"), (True, 4.0, "limited flow")]
)
def test_a_limited_rate_takes_longer_for_larger_steps_and_a_lag_does_not(
    limited: bool, expected: float, word: str
) -> None:
    time = 0.02 * np.arange(1, 6001)
    command = np.where((time // 5.0) % 2 == 1, np.where(time < 60.0, 20e3, 80e3), 0.0)
    pressure = np.zeros_like(time)
    for k in range(1, len(time)):
        change = command[k] - pressure[k - 1]
        step = np.clip(change, -40e3 * 0.02, 40e3 * 0.02) if limited else 0.05 * change
        pressure[k] = pressure[k - 1] + step
    found = step_responses([Recording("run", "day", time, command[:, None], pressure[:, None])])
    assert found.pressure_fill_growth == pytest.approx(expected, rel=0.1)
    assert found.pressure_vent_growth == pytest.approx(expected, rel=0.1)
    assert word in str(found.sentence())


def test_a_run_in_which_no_command_changes_has_no_steps() -> None:
    still = replace(stepped(0.4, 0.4), pressure_cmd=np.full((3000, 1), 20e3))
    assert step_responses([still]).steps == 0


@pytest.mark.parametrize("row_s", [0.05, 0.5])
def test_what_is_quicker_than_a_row_is_part_of_the_step(row_s: float) -> None:
    """Nine tenths within 50 ms and a tenth that creeps for seconds: 63 % are done within two rows, however slow these are."""
    fine = 0.001 * np.arange(1, 60001)
    command = np.where((fine // 10.0) % 2 == 1, 50e3, 0.0)
    since = fine % 10.0
    share = 1.0 - 0.9 * np.exp(-since / 0.05) - 0.1 * np.exp(-since / 2.0)
    pressure = np.where(command > 0.0, share, np.where(fine < 10.0, 0.0, 1.0 - share)) * 50e3
    rows = np.arange(round(1000 * row_s), len(fine) + 1, round(1000 * row_s)) - 1
    found = step_responses([Recording("run", "day", fine[rows], command[rows - 1][:, None], pressure[rows][:, None])])
    assert found.pressure_fill_s is not None and found.pressure_fill_s < max(2.0 * row_s, 0.1)
