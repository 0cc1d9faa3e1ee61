"""Pauses are bridged where nothing much happened, and cut where something did; single wrong samples go, real peaks stay."""


import numpy as np
import pytest

from softrl.diagnosis.checks.gaps import MIN_PART_S, mend, rows
from softrl.diagnosis.checks.spikes import LONGEST, spikes, without_spikes
from softrl.effects.chain import Plant, chain_of
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.check import check_run
from softrl.recordings.recording import Recording

STEP_AT_S = 30.0


def stepped(robot_chambers: int = 3) -> Recording:
    """Return 60 s at 50 Hz of one slow ramp, then a step, of pressure and of motion with it."""
    time = 0.02 * np.arange(1, 3001)
    level = 10e3 * (0.2 * time / STEP_AT_S + (time > STEP_AT_S))
    pressure = np.outer(level, np.eye(robot_chambers)[0])
    position = np.outer(1e-6 * level, [1.0, 0.5, 0.1])
    return Recording("run", "day", time, pressure, pressure, position)


def without(run: Recording, start_s: float, length_s: float) -> Recording:
    return rows(run, (run.time < start_s) | (run.time >= start_s + length_s))


@pytest.mark.parametrize(
    ("start_s", "length_s", "parts"), [(15.0, 1.0, 1), (29.5, 1.0, 2), (15.0, 3.0, 2), (29.9, 0.15, 1)]
)
def test_a_pause_is_cut_only_where_something_unknown_happened(
    body: PccSimulator, start_s: float, length_s: float, parts: int
) -> None:
    run = without(stepped(), start_s, length_s)
    mended = mend(run, check_run(run, body.robot).gaps)
    assert len(mended.parts) == parts
    kept = np.concatenate([part.time for part in mended.parts])
    np.testing.assert_array_equal(kept, run.time)
    assert mended.dropped_s == pytest.approx(length_s if parts == 2 else 0.0, abs=0.05)
    assert mended.bridged_s == pytest.approx(length_s if parts == 1 else 0.0, abs=0.05)


def test_short_parts_between_cuts_are_left_out(body: PccSimulator) -> None:
    run = without(without(stepped(), 29.5, 1.0), 29.0 - 0.5 * MIN_PART_S, 2.5)
    mended = mend(run, check_run(run, body.robot).gaps)
    assert [part.name for part in mended.parts] == ["run, part 1", "run, part 3"]
    assert all(np.ptp(part.time) >= MIN_PART_S for part in mended.parts)


def test_a_bridged_pause_hardly_changes_what_measured_pressure_does(body: PccSimulator) -> None:
    plant, time = Plant(body, chain_of(body.robot, ())), 0.02 * np.arange(1, 1001)
    pressure = np.outer(8e3 * (1.0 - np.cos(0.6 * time)), [1.0, 0.3, 0.0])
    whole = replay(plant, Recording("run", "day", time, pressure, pressure), 0.01, "measured")
    keep = (time % 2.0) < 1.0
    torn = replay(plant, rows(Recording("run", "day", time, pressure, pressure), keep), 0.01, "measured")
    assert whole.position is not None and torn.position is not None
    error = np.linalg.norm(torn.position - whole.position[keep], axis=1)
    assert error.max() < 0.06 * np.ptp(whole.position, axis=0).max()


def test_spikes_are_found_and_nothing_else() -> None:
    time, rng = 0.02 * np.arange(2000), np.random.default_rng(0)
    triangle = np.abs((time % 4.0) - 2.0)
    steps = np.where((time % 8.0) < 4.0, 0.0, 1.0)
    rung = steps * (1.0 - np.exp(-(time % 4.0) / 0.1) * np.cos(12.0 * (time % 4.0)))
    clean = np.stack([triangle, np.sin(9.0 * time), rung], axis=1) + 1e-3 * rng.standard_normal((2000, 3))
    still = np.zeros((len(clean), 2))
    assert not spikes(clean, still).any()
    wrong = np.zeros(2000, dtype=bool)
    for start in range(60, 1900, 230):
        wrong[start : start + 1 + start % LONGEST] = True
    np.testing.assert_array_equal(spikes(clean + 3.0 * np.outer(wrong, [0.5, 0.7, -0.3]), still), wrong)
    jumped = (np.cumsum(wrong) % 2.0)[:, None]
    assert not spikes(clean + 3.0 * np.outer(wrong, [0.5, 0.7, -0.3]), jumped).any()


def test_lone_samples_are_found_in_a_fast_motion() -> None:
    time, rng = np.arange(1500) / 30.0, np.random.default_rng(1)
    swing = np.stack([40.0 * np.sin(2.0 * np.pi * f * time) for f in (0.6, 0.9, 1.3)], axis=1)
    wrong = np.isin(np.arange(1500), np.arange(40, 1480, 120))
    seen = swing + 0.15 * rng.standard_normal((1500, 3))
    still = np.zeros((1500, 2))
    assert not spikes(seen, still).any()
    np.testing.assert_array_equal(spikes(seen + np.outer(wrong, [4.0, -3.0, 2.0]), still), wrong)


def test_a_body_that_turns_round_fast_is_no_spike() -> None:
    time = 0.02 * np.arange(500)
    swing = 25.0 * np.exp(-(((time - 5.0) / 0.12) ** 2))[:, None] * [0.4, 1.0, 0.0]
    corner = np.maximum(20.0 - 125.0 * np.abs(time - 7.0), 0.0)[:, None] * [0.0, 0.7, 0.7]
    assert not spikes(swing + corner + 0.1 * np.random.default_rng(3).standard_normal((500, 3)), np.zeros((500, 1))).any()


def test_steps_of_a_slow_sensor_at_the_turn_of_a_motion_are_no_spikes() -> None:
    time = 0.02 * np.arange(1500)
    read = 0.11 * np.floor(time / 0.11)
    burst = 25.0 * np.exp(-(((read - 15.0) / 0.6) ** 2)) * np.sin(2.0 * np.pi * 2.2 * read)
    moved = np.outer(burst + 5.0 * np.sin(0.8 * read), [1.0, 0.4, 0.0])
    moved += 0.1 * np.random.default_rng(3).standard_normal((1500, 3))
    run = Recording("run", "day", time, np.zeros((1500, 3)), position=moved)
    (kept,), lines = without_spikes([run])
    assert kept is run and not lines


@pytest.mark.parametrize("noise_n", [0.0, 0.02])
def test_a_push_that_is_measured_is_no_spike(noise_n: float) -> None:
    rng, time = np.random.default_rng(3), 0.2 * np.arange(300)
    pushed = ((time % 6.0) > 1.1) & ((time % 6.0) < 1.7)
    mistaken = np.arange(300) % 90 == 45
    moved = np.outer(pushed, [3.0, 1.0, 0.0]) + np.outer(mistaken, [0.0, 4.0, 4.0]) + 0.02 * rng.standard_normal((300, 3))
    force = np.outer(pushed, [0.8, 0.3, 0.0]) + noise_n * rng.standard_normal((300, 3))
    run = Recording("run", "day", time, np.zeros((300, 3)), position=1e-3 * moved, tip_force=force)
    (kept,), _ = without_spikes([run])
    np.testing.assert_array_equal(kept.time, time)
    np.testing.assert_array_equal(kept.unseen, mistaken)


def test_a_change_that_stays_is_no_spike() -> None:
    values = np.where(np.arange(500) < 250, 0.0, 1.0)[:, None]
    assert not spikes(values, np.zeros((len(values), 1))).any()
    command = stepped().pressure_cmd
    assert not spikes(command, np.zeros_like(command)).any()
