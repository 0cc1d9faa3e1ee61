"""Laws of the stage: replay reproduces its own data, keeps names and times, and noise comes from the seed."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.core.errors import ConfigError, RecordingError
from softrl.core.tracking import NullTracker
from softrl.effects.chain import EffectChain, Plant, chain_of
from softrl.effects.delay import Delay
from softrl.effects.lag import Lag
from softrl.effects.pressure_sensor import PressureSensor
from softrl.effects.replay import bend_angle, replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.lost import lost
from softrl.recordings.program import random_steps
from softrl.recordings.read import read
from softrl.recordings.recording import Recording, RecordingSet
from softrl.recordings.write import write
from softrl.robots.robot import Robot
from softrl.simulate.stage import Config, coloured_noise, run, write_out

CONF = Path(__file__).parents[2] / "conf"


def simulator(name: str) -> PccSimulator:
    data = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text())
    data.pop("_target_")
    return PccSimulator(Robot(**yaml.safe_load((CONF / "robot" / f"{name}.yaml").read_text())), **data)


def config(**changed: object) -> Config:
    return Config(
        **(yaml.safe_load((CONF / "stage" / "simulate.yaml").read_text()) | {"seed": 0, "out": None} | changed)
    )


def commands(robot: Robot, seed: int = 1) -> RecordingSet:
    rng = np.random.default_rng(seed)
    runs = []
    for k in range(2):
        time, pressure = random_steps(robot, 6, 1.0, 0.01, rng)
        runs.append(Recording(f"run{k}", "s", time, pressure))
    return RecordingSet(robot.name, tuple(runs))


@pytest.mark.parametrize("name", ["tripod", "single_chamber_finger"])
def test_replay_on_the_grid_is_the_simulation(name: str) -> None:
    body = simulator(name)
    plant = Plant(body, chain_of(body.robot, [Lag(0.1, 0.2), Delay(0.05)]))
    recording = commands(body.robot).recordings[0]
    motion = plant.simulate(recording.time, recording.pressure_cmd)
    replayed = replay(plant, recording, 0.01)
    np.testing.assert_allclose(replayed.position, motion.position, atol=1e-9)
    np.testing.assert_allclose(replayed.quaternion, motion.quaternion, atol=1e-9)
    np.testing.assert_allclose(replayed.pressure_meas, motion.pressure, atol=1e-3)
    assert (replayed.bend_angle is not None) == (name == "single_chamber_finger")


def test_replay_at_uneven_times_converges_to_the_fine_one() -> None:
    body = simulator("tripod")
    plant = Plant(body, chain_of(body.robot, [Lag(0.1, 0.2)]))
    time = np.cumsum(np.random.default_rng(3).uniform(0.01, 0.05, 300))
    recording = Recording("a", "s", time, 2e4 * np.sin(np.outer(time, [1.0, 0.7, 1.3])))
    tips = [replay(plant, recording, dt).position for dt in (0.02, 0.01, 0.005, 0.0025)]
    errors = [np.sqrt(np.mean((a - b) ** 2)) for a, b in pairwise(tips)]
    assert errors[2] < 0.7 * errors[1] < 0.6 * errors[0], errors


def test_measured_drive_bypasses_the_valve() -> None:
    body = simulator("tripod")
    lagging = Plant(body, chain_of(body.robot, [Lag(0.3, 0.3)]))
    recorded = replay(lagging, commands(body.robot).recordings[0], 0.01)
    again = replay(lagging, recorded, 0.01, drive="measured")
    np.testing.assert_allclose(again.position, recorded.position, atol=1e-9)
    with pytest.raises(RecordingError, match="no measured pressure"):
        replay(lagging, commands(body.robot).recordings[0], 0.01, drive="measured")


@pytest.mark.parametrize("gate", [{}, {"since_s": 0.6, "over_s": 0.5}, {"since_s": 2.6, "over_s": 0.5, "begun_s": 2.0}])
def test_a_gauges_error_is_undone_where_its_readings_drive_the_body(gate: dict[str, float]) -> None:
    body = simulator("tripod")
    wrong = Plant(body, chain_of(body.robot, [Lag(0.2, 0.3), PressureSensor(gain=1.2, offset=0.05, **gate)]))
    recorded = replay(wrong, commands(body.robot).recordings[0], 0.01)
    again = replay(wrong, recorded, 0.01, drive="measured")
    np.testing.assert_allclose(again.position, recorded.position, atol=1e-9)
    np.testing.assert_allclose(again.pressure_meas, recorded.pressure_meas, atol=1e-3)
    trusting = replay(Plant(body, chain_of(body.robot, [])), recorded, 0.01, drive="measured")
    assert np.abs(trusting.position - recorded.position).max() > 1e-3


def test_a_gauge_that_misreads_above_a_pressure_only_drives_no_body() -> None:
    body = simulator("tripod")
    recorded = replay(Plant(body, chain_of(body.robot, [])), commands(body.robot).recordings[0], 0.01)
    gauge = PressureSensor(gain=1.2, offset=0.0, above_share=0.5)
    with pytest.raises(ConfigError, match="above a pressure only"):
        replay(Plant(body, chain_of(body.robot, [gauge])), recorded, 0.01, drive="measured")


def test_settling_starts_at_the_first_row() -> None:
    body = simulator("tripod")
    time = 0.01 * np.arange(1, 101)
    held = Recording("a", "s", time, np.full((100, 3), 1e4) * [1.0, 0.0, 0.0])
    plant = Plant(body, chain_of(body.robot, []))
    assert np.ptp(replay(plant, held, 0.01).position, axis=0).max() > 1e-3
    assert np.ptp(replay(plant, held, 0.01, settle_s=3.0).position, axis=0).max() < 1e-6


def test_bend_angle_is_the_tips_turn() -> None:
    finger = simulator("single_chamber_finger")
    for angle in (-0.5, 0.0, 0.7, 2.5):
        _, quaternion = finger.observe(finger.reset()._replace(coordinates=np.array([angle])))
        np.testing.assert_allclose(bend_angle(finger.robot, quaternion[None]), [angle], atol=1e-12)


@pytest.mark.parametrize("every_s", [0.02, 6.0])
def test_an_angle_is_counted_on_beyond_half_a_turn(every_s: float) -> None:
    """Also where every row is another pose, at rest or bent by about 4 rad."""
    curling = replace(simulator("single_chamber_finger"), bend_at_full_pressure_rad=3.8)
    time = np.arange(every_s, 60.0, every_s)
    level = curling.robot.pressure_max_pa * (np.floor(time / 6.0 + 1e-9) % 2.0)[:, None]
    seen = replay(Plant(curling, chain_of(curling.robot, [])), Recording("a", "s", time, level), 0.01).bend_angle
    assert 3.8 < seen.max() < 4.5 and seen.min() > -0.5
    assert every_s > 1.0 or np.abs(np.diff(seen)).max() < 1.0


@pytest.mark.parametrize("angles", [(0.0, 180.0), (180.0, 0.0), (60.0, 240.0)])
def test_the_angle_of_opposite_chambers_has_the_sign_of_the_first(angles: tuple[float, float]) -> None:
    """Each chamber alone bends the tip by as much as the other, the first one to the positive side."""
    robot = replace(simulator("tripod").robot, chamber_angle_deg=angles, output="bend_angle")
    body = PccSimulator(robot, 0.8, 0.0, 1.0, 1.0, 0.05, 1.0)
    time = 0.01 * np.arange(1, 301)
    first, second = (Recording("a", "s", time, np.tile(row, (300, 1))) for row in ([2e4, 0.0], [0.0, 2e4]))
    ends = [replay(Plant(body, chain_of(robot, [])), run, 0.01).bend_angle[-1] for run in (first, second)]
    assert ends[0] > 0.1
    np.testing.assert_allclose(ends[1], -ends[0], rtol=1e-6)


def test_stage_writes_a_dataset_like_its_input(tmp_path: Path) -> None:
    body = simulator("tripod")
    chain = chain_of(body.robot, [Lag(0.2, 0.3)])
    given = commands(body.robot)
    given = replace(given, notes={"out_of_distribution": [given.recordings[-1].name]})
    made = run(config(), body.robot, body, chain, given, tracker=NullTracker())
    write_out(config(out=str(tmp_path / "out")), body.robot, made)
    read_back = read(tmp_path / "out", body.robot)
    assert read_back.notes["out_of_distribution"] == given.notes["out_of_distribution"]
    for ours, theirs, source in zip(made.recordings, read_back.recordings, given.recordings, strict=True):
        assert (theirs.name, theirs.session) == (source.name, source.session)
        np.testing.assert_allclose(theirs.pressure_cmd, source.pressure_cmd, rtol=1e-8)
        np.testing.assert_allclose(theirs.position, ours.position, atol=1e-9)
    tracker = NullTracker()
    run(config(), body.robot, body, chain, read_back, tracker=tracker)
    assert tracker.metrics["recorded/tip_difference_mm"] < 1e-4
    run(config(), body.robot, body, EffectChain(body.robot), read_back, tracker=tracker)
    assert tracker.metrics["recorded/tip_difference_mm"] > 1.0


def test_where_frames_were_lost_nothing_is_compared() -> None:
    body = simulator("tripod")
    chain = EffectChain(body.robot)
    made = run(config(), body.robot, body, chain, commands(body.robot), tracker=NullTracker())
    torn = replace(made, recordings=tuple(lost(r, r.time % 1.0 < 0.4) for r in made.recordings))
    tracker = NullTracker()
    run(config(), body.robot, body, chain, torn, tracker=tracker)
    assert tracker.metrics["recorded/tip_difference_mm"] < 1e-4, "the simulator that made what was seen"


def test_a_temperature_that_drove_an_effect_is_written(tmp_path: Path) -> None:
    body = simulator("tripod")
    warmed = [replace(r, temperature=np.linspace(20.0, 30.0, len(r.time))) for r in commands(body.robot).recordings]
    settings = config(out=str(tmp_path / "simulated"))
    out = run(
        settings, body.robot, body, chain_of(body.robot, []), RecordingSet(body.robot.name, tuple(warmed)), tracker=NullTracker()
    )
    write_out(settings, body.robot, out)
    for here, there in zip(read(tmp_path / "simulated", body.robot).recordings, warmed, strict=True):
        np.testing.assert_allclose(here.temperature, there.temperature, atol=1e-6)


def test_noise_is_seeded_and_of_the_size_asked_for() -> None:
    body = simulator("tripod")
    chain = EffectChain(body.robot)
    noise = {"position_noise_m": 1e-3, "pressure_noise_pa": 200.0, "orientation_noise_rad": 0.01}
    clean, one, same, other = (
        run(config(**changed), body.robot, body, chain, commands(body.robot), tracker=NullTracker()).recordings[1]
        for changed in ({}, noise, noise, noise | {"seed": 1})
    )
    np.testing.assert_array_equal(one.position, same.position)
    assert np.abs(one.position - other.position).max() > 1e-4
    np.testing.assert_allclose((one.position - clean.position).std(), 1e-3, rtol=0.1)
    np.testing.assert_allclose((one.pressure_meas - clean.pressure_meas).std(), 200.0, rtol=0.1)
    np.testing.assert_array_equal(one.pressure_cmd, clean.pressure_cmd)
    turned = 2.0 * np.arccos(np.clip(np.sum(one.quaternion * clean.quaternion, axis=1), -1, 1))
    np.testing.assert_allclose(np.sqrt(np.mean(turned**2) / 3.0), 0.01, rtol=0.1)


def test_coloured_noise_has_its_variance_and_its_memory_at_any_times() -> None:
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.03, 40000))
    noise = coloured_noise(time, (len(time), 2), 0.5, np.random.default_rng(1))
    np.testing.assert_allclose(noise.std(axis=0), 1.0, rtol=0.1)
    for lag in (5, 25, 50):
        expected = np.exp(-np.mean(time[lag:] - time[:-lag]) / 0.5)
        np.testing.assert_allclose(np.mean(noise[lag:] * noise[:-lag]), expected, atol=0.08)
    assert abs(np.mean(noise[:, 0] * noise[:, 1])) < 0.08


def test_white_and_coloured_noise_add_in_square() -> None:
    body = simulator("tripod")
    given = commands(body.robot)
    clean, noisy = (
        run(config(**changed), body.robot, body, EffectChain(body.robot), given, tracker=NullTracker())
        for changed in ({}, {"position_noise_m": 3e-4, "position_colour_m": 4e-4, "colour_s": 0.05})
    )
    added = np.concatenate([a.position - b.position for a, b in zip(noisy.recordings, clean.recordings, strict=True)])
    np.testing.assert_allclose(added.std(), 5e-4, rtol=0.1)


def test_dropped_samples_leave_the_others_as_they_were(tmp_path: Path) -> None:
    body = simulator("tripod")
    chain, given = chain_of(body.robot, [Lag(0.2, 0.3)]), commands(body.robot)
    settings = {"dropped_share": 0.2, "measured_pressure": False, "orientation": False, "out": str(tmp_path / "made")}
    write_out(config(**settings), body.robot, run(config(**settings), body.robot, body, chain, given, tracker=NullTracker()))
    whole = run(config(), body.robot, body, chain, given, tracker=NullTracker())
    for made, full in zip(read(tmp_path / "made", body.robot).recordings, whole.recordings, strict=True):
        assert 0.7 < len(made.time) / len(full.time) < 0.9
        assert made.pressure_meas is None and made.quaternion is None
        left = np.searchsorted(full.time, made.time - 1e-6)
        np.testing.assert_allclose(made.position, full.position[left], atol=1e-9)
        np.testing.assert_allclose(made.pressure_cmd, full.pressure_cmd[left], rtol=1e-8)


def test_chambers_can_differ() -> None:
    """The same effect twice, with other values in another chamber, as the command line can ask for."""
    body = simulator("tripod")
    chain = chain_of(body.robot, [Lag(0.5, 0.5, chamber=0), Lag(0.1, 0.1, chamber=2)])
    made = run(config(), body.robot, body, chain, commands(body.robot), tracker=NullTracker()).recordings[0]
    behind = np.sqrt(np.mean((made.pressure_meas - made.pressure_cmd) ** 2, axis=0))
    assert behind[1] < 1e-6 * behind[2] and behind[2] < 0.8 * behind[0]


def test_bad_config_is_refused() -> None:
    bad_ones = ({"dt_s": 0.0}, {"drive": "wish"}, {"position_noise_m": -1.0}, {"colour_s": 0.0}, {"dropped_share": 1.0})
    for bad in bad_ones:
        with pytest.raises(ConfigError, match="stage"):
            config(**bad)


def test_run_too_long_for_its_step_is_refused() -> None:
    body = simulator("tripod")
    recording = commands(body.robot).recordings[0]
    with pytest.raises(RecordingError, match="raise dt_s"):
        replay(Plant(body, EffectChain(body.robot)), replace(recording, time=recording.time * 1e4), 0.01)


def test_recordings_of_a_robot_are_not_overwritten(tmp_path: Path) -> None:
    body = simulator("tripod")
    chain, given = EffectChain(body.robot), commands(body.robot)
    write(tmp_path / "real", given)
    made = run(config(), body.robot, body, chain, given, tracker=NullTracker())
    with pytest.raises(RecordingError, match="not simulated"):
        write_out(config(out=str(tmp_path / "real")), body.robot, made)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.csv").write_text("mine")
    with pytest.raises(RecordingError, match="something else than a simulated dataset"):
        write_out(config(out=str(tmp_path / "mine")), body.robot, made)
    assert (tmp_path / "mine" / "a.csv").read_text() == "mine"
    for _ in range(2):
        write_out(config(out=str(tmp_path / "made")), body.robot, made)
    assert len(list((tmp_path / "made").glob("*.csv"))) == 2
    (tmp_path / "made" / "monday.csv").write_text("mine")
    with pytest.raises(RecordingError, match=r"made holds monday.csv, which its dataset.yaml does not list"):
        write_out(config(out=str(tmp_path / "made")), body.robot, made)
    assert (tmp_path / "made" / "monday.csv").read_text() == "mine"


def test_what_is_odd_about_recordings_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    body, spent = simulator("tripod"), np.arange(600) < 250
    chain = chain_of(body.robot, [])
    given = commands(body.robot)
    sound = run(config(position_noise_m=1e-4), body.robot, body, chain, given, tracker=NullTracker())
    caplog.clear()
    run(config(), body.robot, body, chain, sound, tracker=NullTracker())
    assert not caplog.records
    odd = [replace(r, position=r.position[:, [1, 0, 2]], quaternion=None) for r in sound.recordings]
    paused = {name: values[spent | (np.arange(600) > 400)] for name, values in odd[0].channels()}
    torn = replace(sound, recordings=(replace(odd[0], **paused), *odd[1:]))
    made = run(config(), body.robot, body, chain, torn, tracker=NullTracker())
    assert len(made.recordings) == len(given.recordings)
    assert "run0: 1 gaps in the samples" in caplog.text and "the tip moves as the mirror image" in caplog.text
