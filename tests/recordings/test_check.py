"""Laws of the data check: it recovers the noise put in, and finds gaps, holds, clipping, idle chambers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.recordings.check import check, check_run, resolution
from softrl.recordings.lost import lost
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"


def robot_named(name: str) -> Robot:
    return Robot(**yaml.safe_load((CONF / "robot" / f"{name}.yaml").read_text()))


TRIPOD = robot_named("tripod")


def run_with_noise(noise_m: float, seed: int, hold: bool = True) -> Recording:
    rng = np.random.default_rng(seed)
    time = 0.01 * np.arange(1, 3001)
    wave = np.floor(time / 5.0) % 2 if hold else 0.5 + 0.5 * np.sin(time)
    pressure = np.outer(wave, [10e3, 10e3, 0.0])
    creep = np.cumsum(wave)[:, None] * [1e-6, 0.0, 0.0]
    position = [0, 0, 0.1765] + 0.02 * np.outer(wave, [1, 0, 0]) + creep + rng.normal(0, noise_m, (len(time), 3))
    return Recording(f"run{seed}", "s", time, pressure, position=position)


def test_noise_is_recovered_from_holds_and_from_differences() -> None:
    for hold, source in ((True, "holds"), (False, "differences")):
        found = check_run(run_with_noise(2e-4, 1, hold), TRIPOD)
        assert found.noise_from == source
        assert abs(found.noise["position"] / 2e-4 - 1.0) < 0.15, found.noise


@pytest.mark.parametrize("hold", [True, False])
def test_what_bridges_lost_frames_is_no_quiet_sensor(hold: bool) -> None:
    """Neither where frames are lost at random, nor where the camera loses the tip at the end of every hold."""
    clean = run_with_noise(2e-4, 1, hold)
    at_random = np.random.default_rng(0).random(3000) < 0.45
    for unseen in (at_random, clean.time % 5.0 > 3.9):
        found = check_run(lost(clean, unseen), TRIPOD)
        assert abs(found.noise["position"] / 2e-4 - 1.0) < 0.15, found.noise


def test_a_run_of_two_samples_says_nothing_about_noise() -> None:
    whole = run_with_noise(2e-4, 1)
    torn = replace(whole, name="torn", time=whole.time[:2], pressure_cmd=whole.pressure_cmd[:2], position=whole.position[:2])
    found = check(RecordingSet("tripod", (whole, torn)), TRIPOD)
    assert found.noise_floor == check(RecordingSet("tripod", (whole,)), TRIPOD).noise_floor


def test_repeats_measure_the_noise_too() -> None:
    runs = tuple(run_with_noise(3e-4, seed) for seed in (1, 2))
    found = check(RecordingSet("tripod", runs), TRIPOD)
    assert abs(found.repeatability["position"] / 3e-4 - 1.0) < 0.1
    sunk = np.asarray(runs[1].position) - np.array([0.0, 0.0, 4e-3])
    loaded = replace(runs[1], position=sunk)  # a load that came in between is no noise
    for other, session, notes in ((loaded, "s", {}), (loaded, "t", {}), (loaded, "s", {"disturbed": [loaded.name]})):
        one = replace(runs[0], session="s")
        found = check(RecordingSet("tripod", (one, replace(other, session=session)), notes), TRIPOD)
        assert found.repeatability.get("position", 3e-4) < 4e-4, found.repeatability
    assert found.excited == (0, 1)
    assert any("chamber 3 is not driven" in warning for warning in found.warnings)


def test_repeats_of_slow_rows_measure_the_noise_by_degrees_of_freedom() -> None:
    """Five rows share a mean, which takes a tenth of the noise along."""
    time, command = np.arange(600.0), np.random.default_rng(0).uniform(0.0, 3e4, (600, 3))
    pose = 1e-6 * command + [0.0, 0.0, 0.1765]
    noisy = [pose + np.random.default_rng(seed).normal(0.0, 3e-4, pose.shape) for seed in (1, 2)]
    runs = tuple(Recording(f"run{k}", "s", time, command, position=position) for k, position in enumerate(noisy))
    assert check(RecordingSet("tripod", runs), TRIPOD).repeatability["position"] == pytest.approx(3e-4, rel=0.05)


def test_gap_hold_and_clipping_are_reported() -> None:
    clean = run_with_noise(1e-4, 1, hold=False)
    assert not check_run(clean, TRIPOD).gaps
    late = np.where(np.arange(3000) < 1000, clean.time, clean.time + 0.7)
    found = check_run(replace(clean, time=late), TRIPOD)
    assert len(found.gaps) == 1
    np.testing.assert_allclose(found.gaps[0], (10.0, 0.71), atol=1e-9)
    slower = np.r_[clean.time[:2000], 20.0 + 0.3 * np.arange(1, 1001)]  # a log that writes fewer rows for a while has no gaps
    assert not check_run(replace(clean, time=slower), TRIPOD).gaps
    found = check_run(replace(clean, time=np.where(np.arange(3000) < 2500, slower, slower + 1.7)), TRIPOD)
    np.testing.assert_allclose(found.gaps, [(20.0 + 0.3 * 500, 2.0)], atol=1e-9)
    held = check_run(replace(clean, position=np.repeat(clean.position[::4], 4, axis=0)), TRIPOD)
    assert abs(held.held["position"] - 0.75) < 0.02
    clipped = np.minimum(clean.position, [0.012, 1.0, 1.0])
    assert any("clipped" in w for w in check_run(replace(clean, position=clipped), TRIPOD).warnings)
    few = slice(0, 3000, 150)  # the largest of twenty samples is no clipping
    sparse = replace(clean, time=clean.time[few], pressure_cmd=clean.pressure_cmd[few], position=clean.position[few])
    assert not any("clipped" in w for w in check_run(sparse, TRIPOD).warnings)


def test_jump_of_orientation_is_reported() -> None:
    clean = run_with_noise(1e-4, 1)
    pose = np.tile([1.0, 0, 0, 0], (3000, 1))
    assert not any("jumps" in w for w in check_run(replace(clean, quaternion=pose), TRIPOD).warnings)
    pose[1500:] = [0.7, 0.714, 0, 0]
    assert any("jumps 1 times" in w for w in check_run(replace(clean, quaternion=pose), TRIPOD).warnings)


@pytest.mark.parametrize("period_s", [0.1, 30.0])
def test_a_robot_that_moves_far_between_slow_rows_has_no_orientation_that_jumps(period_s: float) -> None:
    """Poses along an arc, up to half a turn apart; a marker body that is taken for its mirror turns where it is."""
    bend = np.random.default_rng(0).uniform(-1.5, 1.5, 200)
    tip = 0.1765 * np.stack([(1.0 - np.cos(bend)) / bend, 0.0 * bend, np.sin(bend) / bend], axis=1)
    pose = np.stack([np.cos(0.5 * bend), 0.0 * bend, np.sin(0.5 * bend), 0.0 * bend], axis=1)
    run = Recording("poses", "s", period_s * np.arange(200), np.outer(bend, [0.0, 1e4, 1e4]), position=tip, quaternion=pose)
    found = check_run(run, TRIPOD)
    assert not found.turns_jump and not any("jumps" in warning for warning in found.warnings)
    about_its_axis = pose[:, [3, 2, 1, 0]] * [-1.0, 1.0, -1.0, 1.0]  # by half a turn
    mirrored = np.where((np.arange(200) == 100)[:, None], about_its_axis, pose)
    assert check_run(replace(run, quaternion=mirrored), TRIPOD).turns_jump


def test_a_tip_told_in_another_frame_is_noticed() -> None:
    right = run_with_noise(1e-4, 1)
    assert not [w for w in check_run(right, TRIPOD).warnings if "expected about (0, 0, 176) mm" in w]
    for frame in ([0.0, 0.0, -0.1765], [0.3, 0.0, 0.0]):  # the origin at the tip, or beside the robot
        moved = replace(right, position=right.position + frame)
        assert any("expected about (0, 0, 176) mm" in w for w in check_run(moved, TRIPOD).warnings)


def test_a_run_that_was_broken_off_while_the_robot_came_back_measures_no_noise() -> None:
    whole, other = (run_with_noise(3e-4, seed) for seed in (1, 2))
    back = [0.0, 0.0, 0.1765] + 0.02 * np.exp(-other.time[:220] / 0.3)[:, None]
    aborted = replace(other, name="aborted", time=other.time[:220], pressure_cmd=other.pressure_cmd[:220], position=back)
    at_rest = replace(whole, name="at rest", pressure_cmd=np.zeros_like(whole.pressure_cmd))
    for runs in ((whole, aborted), (at_rest, replace(aborted, pressure_cmd=aborted.pressure_cmd * 0.0))):
        assert not check(RecordingSet("tripod", runs), TRIPOD).repeatability


def test_the_last_digit_of_a_coarse_sensor_is_seen() -> None:
    fine = np.random.default_rng(0).normal(0.0, 0.01, (3000, 2))
    np.testing.assert_allclose(resolution(np.c_[np.round(fine, 3), np.ones(3000)]), [1e-3, 1e-3, 0.0])
    assert resolution(fine).max() == 0.0
    assert resolution(np.random.default_rng(1).choice([0.0, 0.3, 0.47, 0.9], (200, 1))) == 0.0, "levels of a program, no digits"


def test_hours_of_slow_rows_may_be_milliseconds() -> None:
    quick = run_with_noise(2e-4, 1)
    table = replace(quick, **{n: values[:300] for n, values in quick.channels()} | {"time": 20.0 * np.arange(300)})
    for run, told in ((quick, False), (table, False), (replace(quick, time=1e3 * quick.time), True)):
        assert any("name the column time_ms" in warning for warning in check_run(run, TRIPOD).warnings) is told
