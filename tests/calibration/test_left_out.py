"""What no map of a free, undisturbed robot may be fitted to is left out, and told."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.calibration import Calibration
from softrl.calibration import stage
from softrl.calibration.holds import Holds, moving_rows, record_holds, settled_holds, unseen_since
from softrl.calibration.replay import replay
from softrl.calibration.stage import REFINEMENTS, run
from softrl.core.driver import Driver
from softrl.core.errors import RecordingError
from softrl.core.tracking import NullTracker
from softrl.effects.chain import Plant, chain_of
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot
from tests.calibration.test_stage import STEPPING, config


@pytest.fixture
def recorded(driver: Driver, robot: Robot) -> tuple[Recording, ...]:
    c = config()
    return record_holds(driver, robot, 4, c.holds_per_run, c.hold_s, c.dt_s, np.random.default_rng(0)).recordings


def calibrated(robot: Robot, body: PccSimulator, driver: Driver, recordings: RecordingSet) -> Calibration:
    return run(config(), robot, body, chain_of(robot, ()), driver, recordings, tracker=NullTracker())


@pytest.mark.parametrize("notes", [{"disturbed": ["holds_2"]}, {"out_of_distribution": ["holds_2"]}])
def test_marked_runs_are_not_trained_on(
    robot: Robot, body: PccSimulator, driver: Driver, recorded: tuple[Recording, ...], notes: dict[str, list[str]],
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    bumped = replace(recorded[1], position=recorded[1].position + 2e-3)
    every = RecordingSet(robot.name, (recorded[0], bumped, *recorded[2:]), notes)
    found = calibrated(robot, body, driver, every)
    assert "left out as disturbed or out of distribution: holds_2" in caplog.text
    wanted = calibrated(robot, body, driver, RecordingSet(robot.name, (recorded[0], *recorded[2:])))
    np.testing.assert_array_equal(found.pressure_real, wanted.pressure_real)
    for name, weight in wanted.weights.items():
        np.testing.assert_array_equal(found.weights[name], weight)


def test_holds_of_a_loaded_tip_are_not_inverted_as_those_of_a_free_one(
    robot: Robot, body: PccSimulator, driver: Driver, recorded: tuple[Recording, ...], caplog: pytest.LogCaptureFixture
) -> None:
    force = np.tile([0.5, 0.0, 0.0], (len(recorded[1].time), 1))
    pushed = replace(recorded[1], tip_force=force, position=recorded[1].position + np.array([2e-3, 0.0, 0.0]))
    found = calibrated(robot, body, driver, RecordingSet(robot.name, (recorded[0], pushed, *recorded[2:])))
    assert "holds with more than 0.1 N on the tip are left out" in caplog.text
    wanted = calibrated(robot, body, driver, RecordingSet(robot.name, (recorded[0], *recorded[2:])))
    np.testing.assert_array_equal(found.pressure_real, wanted.pressure_real)
    np.testing.assert_array_equal(found.pressure_sim, wanted.pressure_sim)


def test_the_noise_of_a_force_sensor_is_no_load(recorded: tuple[Recording, ...], robot: Robot) -> None:
    rng = np.random.default_rng(1)
    noisy = tuple(replace(r, tip_force=0.05 * rng.standard_normal((len(r.time), 3))) for r in recorded)
    plain, with_force = (settled_holds(RecordingSet("triple", r), 1.0, 0.3, 2e-3, 0.1) for r in (recorded, noisy))
    assert len(plain) == len(with_force)
    loaded = tuple(replace(r, tip_force=np.ones((len(r.time), 3))) for r in recorded)
    with pytest.raises(RecordingError, match="with a force on the tip"):
        settled_holds(RecordingSet("triple", loaded), 1.0, 0.3, 2e-3, 0.1)


def test_moving_rows_of_a_loaded_tip_do_not_count(recorded: tuple[Recording, ...]) -> None:
    force = np.zeros((len(recorded[0].time), 3))
    force[len(force) // 2 :, 2] = -0.5
    touched = RecordingSet("triple", (replace(recorded[0], tip_force=force),))
    rows = moving_rows(touched, {0: 0}, 0.45, 10_000, 0.1)
    assert rows is not None and rows.last_row.max() < len(force) // 2


def test_of_a_single_run_only_what_training_has_not_seen_is_judged(
    robot: Robot, body: PccSimulator, driver: Driver
) -> None:
    """Shaking the tip on the way from hold to hold in the first half touches no metric of what was held out."""
    c = config(average_s=0.3)
    run_ = record_holds(driver, robot, 1, 12, c.hold_s, c.dt_s, np.random.default_rng(0)).recordings[0]
    moving = moving_rows(RecordingSet(robot.name, (run_,)), {0: 0}, 1.0, 10_000)
    assert moving is not None
    early, shaken = moving.last_row[moving.last_row < len(run_.time) // 2], run_.position.copy()
    shaken[early, 0] += 5e-3 * np.sin(10.0 * run_.time[early])
    metrics = []
    for position in (run_.position, shaken):
        tracker, whole = NullTracker(), RecordingSet(robot.name, (replace(run_, position=position),))
        made = run(c, robot, body, chain_of(robot, ()), driver, whole, tracker=tracker)
        metrics.append({name: value for name, value in tracker.metrics.items() if name.startswith("heldout/")})
        assert not made.heldout[: len(made.heldout) // 2].any()
    assert "heldout/position_run_mm" in metrics[0] and metrics[0] == metrics[1]


def test_rows_are_unseen_behind_the_last_hold_of_training() -> None:
    holds = Holds(np.zeros((5, 3)), np.zeros((5, 3)), np.array([0, 0, 0, 1, 1]), np.array([9, 19, 29, 9, 19]))
    assert unseen_since(holds, np.array([False, False, True, False, False])) == {0: 20}
    assert unseen_since(holds, np.array([False, False, False, True, True])) == {1: 0}


def test_a_recorded_force_acts_in_the_replay(robot: Robot, body: PccSimulator) -> None:
    time = 0.02 * np.arange(1, 101)
    pressure, force = np.full((100, 3), 5e3), np.outer(np.sin(time), [0.3, 0.0, 0.0])
    plant = Plant(body, chain_of(robot, ()))
    even = np.vstack([force[:1], 0.5 * (force[1:] + force[:-1])])  # a force that is measured changes evenly between its rows
    pushed, free = (plant.simulate(time, pressure, f).position for f in (even, None))
    early = Recording("a", "s", time[:50], pressure[:50])
    late = Recording("b", "s", time[50:], pressure[50:], tip_force=force[50:])
    even = np.where(np.arange(100)[:, None] > 50, even, np.where(np.arange(100)[:, None] == 50, 0.5 * force, 0.0))
    only_late = plant.simulate(time, pressure, even).position
    np.testing.assert_allclose(replay(plant, [early, late], lambda p: p, STEPPING)[1].position, only_late[50:], atol=1e-12)
    whole = Recording("a", "s", time, pressure, tip_force=force)
    np.testing.assert_allclose(replay(plant, [whole], lambda p: p, STEPPING)[0].position, pushed, atol=1e-12)
    np.testing.assert_allclose(
        replay(plant, [replace(whole, tip_force=None)], lambda p: p, STEPPING)[0].position, free, atol=1e-12
    )


def test_recorded_tips_are_inverted_once(
    robot: Robot, body: PccSimulator, driver: Driver, recorded: tuple[Recording, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often f_RS is refined, where the body alone rests at them stays the same."""
    asked: list[np.ndarray] = []

    def invert(simulator: object, tip: np.ndarray, start: np.ndarray, *rest: float) -> tuple[np.ndarray, np.ndarray]:
        asked.append(tip)
        return 1.1 * start, np.zeros(len(tip))

    monkeypatch.setattr(stage, "pressure_by_simulator", invert)
    creep = chain_of(robot, [Viscoelasticity(0.3, 4.0, 0.0, 20.0)])
    made = run(config(), robot, body, creep, driver, RecordingSet(robot.name, recorded), tracker=NullTracker())
    of_robot = [
        tips for tips in asked if np.isin(made.settled_tip, tips).all() or np.isin(tips, made.settled_tip).all()
    ]
    assert len(of_robot) == 1
    assert len(asked) == 1 + 1 + REFINEMENTS
