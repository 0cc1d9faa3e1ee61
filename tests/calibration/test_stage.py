"""The stage on a robot whose pressures are known to be off: it finds them, and the simulator then meets the robot."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from softrl.calibration import stage
from softrl.calibration.holds import AGAIN, Holds, moving_rows, record_holds, revisited, settled_holds, split_holds
from softrl.calibration.inversion import pressure_by_simulator, steady_tip
from softrl.calibration.kinematics import rotation_vector
from softrl.calibration.pressure_map import PressureMap
from softrl.calibration.replay import Stepping, replay, replay_errors
from softrl.calibration.stage import Config, run
from softrl.core.driver import Driver, Sample
from softrl.core.errors import ConfigError, DriverError, RecordingError
from softrl.core.tracking import NullTracker
from softrl.effects.chain import Plant, chain_of
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.program import random_steps
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

CONF = Path(__file__).resolve().parents[2] / "conf" / "stage"
STEPPING = Stepping(0.02, 0.0)


def config(**changes: object) -> Config:
    merged = OmegaConf.merge(
        OmegaConf.create({"seed": 0}),
        {
            "stage": OmegaConf.merge(
                OmegaConf.load(CONF / "calibration.yaml"),
                OmegaConf.load(CONF.parent / "profile/tiny/calibration.yaml"),
                changes,
            )
        },
    )
    return Config(**OmegaConf.to_container(merged.stage, resolve=True))  # type: ignore[arg-type]


FAST = {"runs": 8, "holds_per_run": 14, "hold_s": 2.0, "hold_min_s": 1.5, "dt_s": 0.02, "settle_s": 2.0, "hidden": 8,
        "epochs": 1500, "members": 3, "weight_decays": [5e-5, 1e-2], "drift_max_mm": 0.2, "residual_max_mm":
        0.5}  # fmt: skip


def test_stage_finds_the_pressures_that_acted(
    robot: Robot, body: PccSimulator, driver: Driver, acting: Callable[[np.ndarray], np.ndarray]
) -> None:
    tracker = NullTracker()
    calibration = run(config(**FAST), robot, body, chain_of(robot, ()), driver, None, tracker=tracker)
    assert not driver.connected  # type: ignore[attr-defined]
    inside = np.random.default_rng(1).uniform(-15e3, 30e3, (50, 3))
    error = PressureMap(calibration).real_to_sim(inside) - acting(inside)
    assert np.sqrt(np.mean(error**2)) < 80.0, f"f_RS is off by {np.sqrt(np.mean(error**2)):.0f} Pa"
    m = tracker.metrics
    assert m["heldout/pressure_map_rms_kpa"] < 0.1 * m["heldout/pressure_map_identity_rms_kpa"]
    assert m["heldout/position_hold_mm"] < 0.1 * m["heldout/uncalibrated_position_hold_mm"]
    assert m["heldout/arc_length_hold_mm"] < m["heldout/uncalibrated_arc_length_hold_mm"]
    assert 0.0 < m["heldout/position_hold_pct"] < m["heldout/uncalibrated_position_hold_pct"] < 100.0
    assert calibration.material["chosen"] == "yeoh"
    assert m["revisited_pressures_count"] > 5 and m["revisited_pressure_rms_kpa"] < m["heldout/pressure_map_rms_kpa"] + 0.05
    assert len(calibration.settled_tip) > len(calibration.pressure_real), "the second visits train and judge nothing"


def test_with_the_walls_creep_in_the_simulator_f_rs_is_the_regulators(
    robot: Robot, body: PccSimulator, driver: Driver, acting: Callable[[np.ndarray], np.ndarray]
) -> None:
    """Creep of earlier holds shows in later ones: no static map can tell, a simulator that creeps can."""
    creep, rng, recordings = chain_of(robot, [Viscoelasticity(0.3, 4.0, 0.0, 20.0)]), np.random.default_rng(2), []
    for k in range(8):
        time, pressure = random_steps(robot, 14, 2.0, 0.02, rng)
        motion = Plant(body, creep).simulate(time, acting(pressure))
        recordings.append(Recording(f"r{k}", "s", time, pressure, position=motion.position, quaternion=motion.quaternion))
    error, whole = {}, RecordingSet(robot.name, tuple(recordings))
    for name, chain in (("nominal", chain_of(robot, ())), ("corrected", creep)):
        tracker = NullTracker()
        made = run(config(**FAST | {"drift_max_mm": 2.0}), robot, body, chain, driver, whole, tracker=tracker)
        error[name] = tracker.metrics
        assert made.effects == (() if name == "nominal" else ("viscoelasticity",))
    for what in ("pressure_map_rms_kpa", "position_hold_mm", "velocity_run_mm_s"):
        assert error["corrected"][f"heldout/{what}"] < 0.2 * error["nominal"][f"heldout/{what}"], what
    inside = rng.uniform(-15e3, 30e3, (50, 3))
    assert np.sqrt(np.mean((PressureMap(made).real_to_sim(inside) - acting(inside)) ** 2)) < 80.0


def test_tiny_runs_with_one_seed_are_identical(
    robot: Robot, body: PccSimulator, driver: Driver, tmp_path: Path
) -> None:
    first, second = (run(config(), robot, body, chain_of(robot, ()), driver, None, tracker=NullTracker()) for _ in range(2))
    np.testing.assert_array_equal(first.pressure_sim, second.pressure_sim)
    for name, weight in first.weights.items():
        np.testing.assert_array_equal(weight, second.weights[name])
    first.save(tmp_path / "calibration")
    loaded = type(first).load(tmp_path / "calibration")
    pressure = np.array([[1e3, 2e3, 3e3]])
    np.testing.assert_array_equal(PressureMap(loaded).real_to_sim(pressure), PressureMap(first).real_to_sim(pressure))


def test_held_out_runs_do_not_touch_training(robot: Robot, body: PccSimulator, driver: Driver) -> None:
    """Spoiling the recorded tips of the held-out run leaves weights and scalers as they were."""
    whole = record_of(driver, robot, body, config())
    first = run(config(), robot, body, chain_of(robot, ()), driver, whole, tracker=NullTracker())
    held = int(np.unique(runs_of(whole)[first.heldout])[0])
    spoilt = list(whole.recordings)
    old = spoilt[held]
    spoilt[held] = Recording(old.name, old.session, old.time, old.pressure_cmd, position=old.position + 1e-3)
    nominal = chain_of(robot, ())
    second = run(config(), robot, body, nominal, driver, RecordingSet(robot.name, tuple(spoilt)), tracker=NullTracker())
    assert not np.array_equal(first.pressure_sim, second.pressure_sim)
    np.testing.assert_array_equal(first.pressure_mean, second.pressure_mean)
    np.testing.assert_array_equal(first.correction_spread, second.correction_spread)
    np.testing.assert_array_equal(first.weights["skip"], second.weights["skip"])


def record_of(driver: Driver, robot: Robot, body: PccSimulator, c: Config) -> RecordingSet:
    return record_holds(driver, robot, c.runs, c.holds_per_run, c.hold_s, c.dt_s, np.random.default_rng(0))


def runs_of(recordings: RecordingSet) -> np.ndarray:
    return settled_holds(recordings, 1.5, 0.3, 2e-3).run


def test_inversion_finds_pressures_of_a_known_tip(body: PccSimulator) -> None:
    pressure = np.array([[5e3, 20e3, -8e3], [0.0, 0.0, 0.0]])
    tip = np.stack([steady_tip(body, row, 2.0, 0.02) for row in pressure])
    found, miss = pressure_by_simulator(body, tip, np.full((2, 3), 1e3), 2.0, 0.02)
    np.testing.assert_allclose(found, pressure, atol=5.0)
    assert miss.max() < 1e-6


def test_visits_of_one_pressure_tell_what_no_static_map_can() -> None:
    rng = np.random.default_rng(0)
    pressure = np.repeat(rng.uniform(-2e4, 3e4, (400, 3)), 2, axis=0)
    found, count = revisited(pressure, np.sin(1e-4 * pressure) * 1e4 + rng.normal(0.0, 50.0, pressure.shape))
    assert count == 400 and found == pytest.approx(50.0, rel=0.1)
    assert revisited(pressure, 2.0 * pressure) == (0.0, 400)
    assert np.isnan(revisited(pressure[::2], pressure[::2])[0])


def test_the_first_run_is_visited_again_in_another_order(driver: Driver, robot: Robot) -> None:
    made = record_holds(driver, robot, 2, 6, 1.0, 0.02, np.random.default_rng(0), again=True)
    first, last = made.recordings[0], made.recordings[-1]
    assert [r.name for r in made.recordings[2:]] == [AGAIN]
    visited = [set(map(tuple, settled_holds(RecordingSet("x", (r,)), 0.5, 0.2, 1.0).pressure)) for r in (first, last)]
    assert visited[0] == visited[1] and not np.array_equal(first.pressure_cmd, last.pressure_cmd)


class Folder(NullTracker):
    """Keeps texts."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: dict[str, str] = {}

    def text(self, name: str, content: str) -> None:
        self.texts[name] = content


@pytest.mark.parametrize("error", [KeyboardInterrupt, DriverError])
def test_what_was_recorded_before_a_session_broke_off_is_kept(
    driver: Driver, robot: Robot, body: PccSimulator, tmp_path: Path, error: type[BaseException]
) -> None:
    advance, tracker, c = driver.advance, Folder(), config()
    one_run_s = len(random_steps(robot, c.holds_per_run, c.hold_s, c.dt_s, np.random.default_rng(0))[0]) * c.dt_s

    def broken(dt_s: float) -> list[Sample]:
        if driver.time_s > 1.5 * one_run_s:  # type: ignore[attr-defined]
            raise error("cable")
        return advance(dt_s)

    driver.advance = broken  # type: ignore[method-assign]
    with pytest.raises(error, match="cable"):
        run(c, robot, body, chain_of(robot, ()), driver, None, tracker=tracker)
    for name, text in tracker.texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    kept = RecordingSet.read(tmp_path / "interrupted", {}).recordings
    assert [r.name for r in kept] == ["holds_1", "interrupted"]
    assert np.ptp(np.hstack([r.time for r in kept])) == pytest.approx(1.5 * one_run_s, rel=0.05)
    assert kept[1].time[0] > kept[0].time[-1], "nothing is kept twice"


def test_a_camera_that_never_sees_the_tip_is_told_and_its_recordings_are_kept(
    driver: Driver, robot: Robot, body: PccSimulator
) -> None:
    advance, tracker = driver.advance, Folder()
    driver.advance = lambda dt_s: [replace(s, position=np.full(3, np.nan)) for s in advance(dt_s)]  # type: ignore[method-assign]
    with pytest.raises(RecordingError, match="hold 0 settled holds with tip positions"):
        run(config(visit_again=True), robot, body, chain_of(robot, ()), driver, None, tracker=tracker)
    assert "interrupted/holds_1.csv" in tracker.texts


def test_moving_rows_are_those_soon_after_a_change() -> None:
    time = 0.1 * np.arange(1, 101)
    pressure = np.zeros((100, 3))
    pressure[20:60, 1] = 5e3
    pressure[60:, 0] = 1e3
    one = Recording("a", "s", time, pressure, position=np.outer(time, np.ones(3)))
    rows = moving_rows(RecordingSet("triple", (one, one)), {1: 0}, 0.45, 1000)
    assert rows is not None and rows.last_row.tolist() == [20, 21, 22, 23, 24, 60, 61, 62, 63, 64]
    assert set(rows.run) == {1}
    np.testing.assert_array_equal(rows.position[:, 0], time[rows.last_row])
    still = Recording("a", "s", time, 0 * pressure, position=np.zeros((100, 3)))
    assert moving_rows(RecordingSet("triple", (still,)), {0: 0}, 0.45, 3) is None
    few = moving_rows(RecordingSet("triple", (one,)), {0: 0}, 0.45, 3)
    assert few is not None and few.last_row.tolist() == [20, 24, 64] and few.pressure[1].tolist() == [0.0, 5e3, 0.0]


def test_errors_in_per_cent_are_those_of_what_was_spanned(robot: Robot, body: PccSimulator) -> None:
    time = 0.02 * np.arange(1, 151)
    pressure = 2e4 * np.abs(np.sin(time[:, None] + np.arange(3)))
    moved = body.simulate(time, pressure)
    holds = Holds(pressure[-1:], moved.position[-1:], np.array([0]), np.array([149]))
    one = Recording("a", "s", time, pressure, position=moved.position, quaternion=moved.quaternion)
    plant = Plant(body, chain_of(robot, ()))
    exact = replay_errors(plant, RecordingSet(robot.name, (one,)), holds, {0: 0}, lambda p: p, STEPPING)
    half = replay_errors(plant, RecordingSet(robot.name, (one,)), holds, {0: 0}, lambda p: 0.5 * p, STEPPING)
    assert exact["position_run_pct"] < 1e-6
    for name, unit, scale in (("position", "mm", 1e3), ("orientation", "deg", 180.0 / np.pi)):
        values = moved.position if name == "position" else rotation_vector(moved.quaternion)
        span = scale * np.linalg.norm(np.ptp(values, axis=0))
        assert half[f"{name}_run_pct"] == pytest.approx(100.0 * half[f"{name}_run_{unit}"] / span)
        assert 1.0 < half[f"{name}_run_pct"] < 100.0
    still = Recording("a", "s", time, 0 * pressure, position=np.tile(moved.position[:1], (150, 1)))
    stood = replay_errors(plant, RecordingSet(robot.name, (still,)), holds, {0: 0}, lambda p: p, STEPPING)
    assert not [name for name in stood if "pct" in name]


@pytest.mark.parametrize("row_s", [0.02, 1.0])
def test_recordings_on_one_clock_are_one_motion(robot: Robot, body: PccSimulator, row_s: float) -> None:
    """What an earlier recording left in the wall is there in the next, but not after a pause, or in another session."""
    time = row_s * np.arange(1, 301)
    pressure = np.where(np.arange(300)[:, None] < 148, 3e4, 0.0) * np.ones(3)
    plant = Plant(body, chain_of(robot, [Viscoelasticity(0.3, 4.0, 0.0, 20.0)]))
    position = replay(plant, [Recording("whole", "s", time, pressure)], lambda p: p, STEPPING)[0].position

    def second_half(later_s: float, session: str) -> np.ndarray:
        early = Recording("a", "s", time[:150], pressure[:150])
        late = Recording("b", session, time[150:] + later_s, pressure[150:])
        return replay(plant, [early, late], lambda p: p, STEPPING)[1].position

    np.testing.assert_allclose(second_half(0.0, "s"), position[150:], atol=1e-12)
    for forgotten in (second_half(60.0, "s"), second_half(0.0, "t")):
        assert np.abs(forgotten - position[150:]).max() > 1e-3


def test_moving_holds_are_left_out_and_too_few_are_told() -> None:
    time = np.arange(1, 301) * 0.02
    creeping = np.stack([0 * time, 0 * time, 0.17 + 1e-3 * time], axis=1)
    one = Recording("a", "s", time, np.zeros((300, 3)), position=creeping)
    with pytest.raises(RecordingError, match="hold 0 settled holds"):
        settled_holds(RecordingSet("triple", (one,)), 1.0, 0.5, 1e-4)


@pytest.mark.parametrize("row_s", [0.02, 0.1, 0.5, 0.6, 1.0])
@pytest.mark.parametrize("row_speed", [0.5, 0.9, 1.1, 2.0])
def test_what_a_tip_may_drift_is_the_same_however_far_apart_rows_are(row_s: float, row_speed: float) -> None:
    """In the last half second it drifts by ``row_speed`` times what it may; one row alone would never seem to."""
    time = np.arange(1, round(24.0 / row_s) + 1) * row_s
    pressure = np.repeat(1e4 * np.eye(3)[[0, 1, 2, 0, 1, 2]], len(time) // 6, axis=0)
    moving = np.outer(row_speed * 0.3e-3 / 0.5 * time[: len(pressure)], [0.0, 0.0, 1.0])
    one = RecordingSet("triple", (Recording("a", "s", time[: len(pressure)], pressure, position=moving),))
    if row_speed < 1.0:
        assert len(settled_holds(one, 2.0, 0.5, 0.3e-3)) == 6
    else:
        with pytest.raises(RecordingError, match="6 still moving"):
            settled_holds(one, 2.0, 0.5, 0.3e-3)


def test_noise_of_a_camera_is_no_drift() -> None:
    """0.5 mm an axis, of which means of a quarter of a second have 0.2 between them, and twice that was told as drift."""
    rng, time = np.random.default_rng(0), np.arange(1, 40 * 150 + 1) * 0.02
    pressure = np.repeat(rng.uniform(0.0, 3e4, (40, 3)), 150, axis=0)
    one = Recording("a", "s", time, pressure, position=rng.normal(0.0, 0.5e-3, (len(time), 3)))
    assert len(settled_holds(RecordingSet("triple", (one,)), 2.0, 0.5, 0.3e-3).run) >= 36


def test_two_rows_a_hold_do_not_tell_whether_it_settled() -> None:
    time = 3.0 * np.arange(1, 13)
    one = Recording("a", "s", time, np.repeat(1e4 * np.eye(3)[[0, 1, 2, 0, 1, 2]], 2, axis=0), position=np.zeros((12, 3)))
    with pytest.raises(RecordingError, match="6 of too few rows to tell"):
        settled_holds(RecordingSet("triple", (one,)), 2.0, 0.5, 0.3e-3)


def test_whole_runs_are_held_out_and_the_end_of_a_single_one() -> None:
    def holds(run: list[int]) -> Holds:
        n = len(run)
        return Holds(np.zeros((n, 3)), np.zeros((n, 3)), np.array(run), np.arange(n))

    out = split_holds(holds([0, 0, 1, 1, 2, 2]), 0.3, np.random.default_rng(0))
    assert out.reshape(3, 2).all(axis=1).sum() == 1
    assert out.sum() == 2
    assert split_holds(holds([0] * 10), 0.3, np.random.default_rng(0)).tolist() == [False] * 7 + [True] * 3
    for made in (holds([0] * 8), holds([0, 1])):
        for share in (0.01, 0.99):
            assert 0 < split_holds(made, share, np.random.default_rng(0)).sum() < len(made), "one trains and one judges"


def test_a_single_hold_is_no_map(
    robot: Robot, body: PccSimulator, driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the other run, of all holds but one, is held out: nothing is left to judge a member by."""
    whole = record_of(driver, robot, body, config())
    monkeypatch.setattr(stage, "split_holds", lambda holds, *_: np.arange(len(holds)) > 0)
    with pytest.raises(RecordingError, match=r"1 of \d+ settled holds trains f_RS, .* expected 2 or more"):
        run(config(), robot, body, chain_of(robot, ()), driver, whole, tracker=NullTracker())


@pytest.mark.parametrize(
    ("key", "value"),
    [("members", 1), ("heldout_share", 1.5), ("hold_min_s", 9.0), ("runs", 0), ("curve_blocks", 1), ("curve_bins", -3),
     ("curve_bins", 10), ("stretch_max", float("nan")), ("learning_rate", float("inf")), ("stood_s", -1.0), ("settle_s", 0.014),
     ("holds_per_run", 2)],
)  # fmt: skip
def test_bad_values_name_the_key(key: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"stage.*{key}={value:g}"):
        config(**{key: value})


def test_simulator_out_of_reach_is_told(robot: Robot, body: PccSimulator, driver: Driver) -> None:
    recordings = record_of(driver, robot, body, config())
    far = tuple(
        Recording(r.name, r.session, r.time, r.pressure_cmd, position=np.asarray(r.position) + 1e3)
        for r in recordings.recordings
    )
    with pytest.raises(RecordingError, match="check frame and units"):
        nominal = chain_of(robot, ())
        run(config(drift_max_mm=1e4), robot, body, nominal, driver, RecordingSet(robot.name, far), tracker=NullTracker())
