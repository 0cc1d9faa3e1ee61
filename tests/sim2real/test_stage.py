"""The stage on a rig that is what the simulator says, and on one that is not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy, observation_size
from softrl.artifacts.surrogate import Surrogate
from softrl.core.driver import Sample
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.simulator import Simulator
from softrl.core.tracking import NullTracker
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.library import names
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.recordings.recording import RecordingSet
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.controller import ModelController, PolicyController
from softrl.sim2real.controllers import Models, controllers, prepare
from softrl.sim2real.course import Course, task_of
from softrl.sim2real.drivers.rig import Noise
from softrl.sim2real.identification import session_program
from softrl.sim2real.rollout import Pace, follow
from softrl.sim2real.stage import Config, run
from softrl.sim2real.watch import Watch
from tests.sim2real.conftest import BenchDriver, task_numbers

HIDDEN = (Lag(fill_s=0.137, vent_s=0.219), Viscoelasticity(0.313, 0.71, 0.0, 1.0))


@pytest.fixture(scope="module")
def everything(
    tripod: Robot, body: Simulator, silence: Noise, policy: Policy, surrogate: Surrogate, calibration: Calibration
) -> "Stage":
    noise = replace(silence, position_white_mm=0.05, dropped_share=0.01)
    return Stage(tripod, body, noise, policy, surrogate, calibration)


class Stage:
    """The stage with its artifacts; ``run`` puts it on a rig with effects."""

    def __init__(
        self, robot: Robot, body: Simulator, noise: Noise, policy: Policy, surrogate: Surrogate,
        calibration: Calibration,
    ) -> None:
        self.robot, self.body, self.noise = robot, body, noise
        self.inputs = (policy, surrogate, calibration)

    def run(self, config: Config, *effects: Effect, known: tuple[Effect, ...] = ()) -> tuple[RecordingSet, dict[str, float]]:
        tracker = NullTracker()
        driver = BenchDriver(self.robot, self.body, self.noise, effects)
        plant = (self.body, chain_of(self.robot, known))
        return run(config, self.robot, *self.inputs, *plant, driver, tracker=tracker), tracker.metrics


@pytest.fixture(scope="module")
def done(everything: Stage, config: Config) -> "Done":
    """Return what the stage makes of a rig with hidden physics."""
    return everything.run(config, *HIDDEN)


Done = tuple[RecordingSet, dict[str, float]]


def test_what_it_records(done: Done, config: Config) -> None:
    recorded, metrics = done
    names_of = [r.name for r in recorded.recordings]
    for shape in ("circle", "star", "figure_eight"):
        assert f"{shape}_policy" in names_of and f"{shape}_open_loop" in names_of
        assert metrics[f"{shape}_mm"] > 0.0 and metrics[f"{shape}_open_loop_mm"] > 0.0
    sessions = [s for s in recorded.sessions() if s.startswith("identification")]
    assert len(sessions) == config.identification.sessions >= 4
    assert metrics["samples"] == sum(len(r.time) for r in recorded.recordings)
    assert metrics["inference_hz"] > 0.0
    for recording in recorded.recordings:
        assert (np.diff(recording.time) > 0.0).all()
        assert recording.pressure_cmd.shape == recording.pressure_meas.shape == (len(recording.time), 3)
        assert recording.tip_force is None, "the rig has no force sensor"


def test_two_runs_of_one_seed_record_the_same(everything: Stage, done: Done, config: Config) -> None:
    again, _ = everything.run(config, *HIDDEN)
    for one, two in zip(done[0].recordings, again.recordings, strict=True):
        np.testing.assert_array_equal(one.position, two.position)
        np.testing.assert_array_equal(one.pressure_cmd, two.pressure_cmd)


def test_hidden_physics_makes_the_rollouts_worse(everything: Stage, done: Done, config: Config) -> None:
    _, plain = everything.run(config)
    assert done[1]["circle_mm"] > plain["circle_mm"] + 0.3


def test_nothing_of_the_hidden_physics_is_written(done: Done, tmp_path: Path) -> None:
    recorded, _ = done
    recorded.save(tmp_path / "recordings")
    again = RecordingSet.load(tmp_path / "recordings")
    assert again.notes == recorded.notes
    told = [path.read_text() for path in (tmp_path / "recordings").iterdir() if path.suffix != ".csv"]
    told += [path.read_text().splitlines()[0] for path in (tmp_path / "recordings").glob("*.csv")]
    text = "\n".join(told).lower()
    for secret in [*set(names()) - {"frame"}, "0.137", "0.219", "0.313", "0.71", "softrl."]:
        assert secret not in text, f"the dataset tells of {secret}"
    for recording, read in zip(recorded.recordings, again.recordings, strict=True):
        assert recording.session == read.session
        np.testing.assert_allclose(read.position, recording.position, atol=1e-9)


def test_without_feedback_a_true_robot_is_where_the_model_says(everything: Stage, silence: Noise) -> None:
    robot, surrogate = everything.robot, everything.inputs[1]
    driver = BenchDriver(robot, everything.body, silence)
    course = Course.free("still", np.tile(surrogate.sample_tip[3], (4, 1)))
    policy, space = everything.inputs[0], Workspace(surrogate)
    controller = ModelController(space, task_of(policy, 4, 0.8), course)
    rollout = follow(driver, robot, controller, course, Pace(2.0, 1, 2), "still", "still")
    assert rollout.error_m() < 1e-3
    assert not driver.connected


def test_the_average_is_what_is_sent(everything: Stage, silence: Noise) -> None:
    class Alternating:
        def pressure(self, position: np.ndarray, step: int, tip_force: np.ndarray | None = None) -> np.ndarray:
            return np.full(3, 10e3 if step % 2 else 20e3)

    driver = BenchDriver(everything.robot, everything.body, silence)
    course = Course.free("average", np.zeros((6, 3)))
    rollout = follow(driver, everything.robot, Alternating(), course, Pace(0.5, 2, 0), "average", "average")
    commanded = rollout.recording.pressure_cmd[100::50, 0]
    np.testing.assert_allclose(commanded[1:], 15e3)


def test_the_policy_sees_the_curve_as_closed(everything: Stage) -> None:
    """After the last target comes the first: at the last step a policy that looks ahead heeds where the curve begins."""
    policy, surrogate, calibration = everything.inputs
    size = observation_size(policy.horizon, policy.memory)
    weight = np.random.default_rng(0).normal(size=(len(policy.weights["weight_0"]), size)) / 4.0
    ahead = replace(policy, weights=policy.weights | {"weight_0": weight})
    course = Course.free("five", surrogate.sample_tip[:5])
    moved = replace(course, position=np.vstack([surrogate.sample_tip[5:6], course.position[1:]]))
    tip = course.position[3]
    for step, heeds in ((4, True), (3, False)):
        one, other = (PolicyController(ahead, surrogate, calibration, c).pressure(tip, step) for c in (course, moved))
        assert (np.abs(one - other).max() > 1.0) == heeds, f"step {step}"


def test_a_policy_with_a_memory_learns_nothing_from_a_broken_line(everything: Stage) -> None:
    policy, surrogate, calibration = everything.inputs
    size = observation_size(policy.horizon, 2)
    weight = np.random.default_rng(0).normal(size=(len(policy.weights["weight_0"]), size)) / 4.0
    remembering = replace(policy, weights=policy.weights | {"weight_0": weight}, memory=2)
    course = Course.free("eight", surrogate.sample_tip[:8])

    def asked(supplied_pa: float, tip: np.ndarray) -> np.ndarray:
        """Return the answer to a tip at step 2, chambers told 10 kPa being supplied with less or not."""
        controller = PolicyController(remembering, surrogate, calibration, course, Watch(2.0, 3.0, 0.4, 3))
        told, upright, nothing = np.full(3, 10e3), np.array([1.0, 0.0, 0.0, 0.0]), np.full(3, np.nan)
        for step, supplied in enumerate((10e3, 10e3, supplied_pa)):
            times = 0.5 * step + 0.1 * np.arange(1, 6)
            controller.watch([Sample(t, told, np.full(3, supplied), tip, upright, nothing) for t in times], step)
            answer = controller.pressure(tip if step == 2 else course.position[step], step)
        return answer

    tips = course.position[1], course.position[5]
    for supplied_pa, differ in ((10e3, True), (0.0, False)):
        first, second = (asked(supplied_pa, tip) for tip in tips)
        assert (np.abs(first - second).max() > 1.0) == differ


def test_the_map_of_the_real_robot_is_applied(everything: Stage) -> None:
    policy, surrogate, calibration = everything.inputs
    target = surrogate.sample_tip[:3]
    course = Course.free("three", target)
    raised = replace(calibration, weights=calibration.weights | {"bias": np.full((2, 3), 700.0)})
    plain = PolicyController(policy, surrogate, calibration, course).pressure(target[0], 0)
    mapped = PolicyController(policy, surrogate, raised, course).pressure(target[0], 0)
    np.testing.assert_allclose(plain - mapped, 700.0, atol=0.1)


def test_a_retuned_body_takes_the_robots_own_pressures(everything: Stage, config: Config) -> None:
    policy, surrogate, calibration = everything.inputs
    raised = replace(calibration, weights=calibration.weights | {"bias": np.full((2, 3), 700.0)})
    course = Course.free("three", surrogate.sample_tip[:3])

    def sent(given: Calibration, retuned: bool) -> dict[str, np.ndarray]:
        """Return what the controllers send at the first target."""
        plant = Plant(everything.body, replace(chain_of(everything.robot, []), retuned=retuned))
        task, space = task_of(policy, 3, 0.8), Workspace(surrogate)
        models = Models(everything.robot, replace(policy, retuned=retuned), space, task, given, plant)
        made = prepare(models, config.planning, config.pace, course)
        found = controllers(models, config.planning, config.pace, course, made)
        return {name: found[name].pressure(course.position[0], 0) for name in ("policy", "feedforward", "planned")}

    for retuned, apart_pa in ((True, 0.0), (False, 700.0)):
        plain, mapped = sent(calibration, retuned), sent(raised, retuned)
        for name in plain:
            np.testing.assert_allclose(plain[name] - mapped[name], apart_pa, atol=0.1, err_msg=name)


def test_each_session_differs_and_stays_within_the_limits(tripod: Robot, config: Config) -> None:
    rng = np.random.default_rng(0)
    programs = [session_program(tripod, config.identification, k, rng)[1] for k in range(4)]
    assert not np.array_equal(programs[0], programs[3])
    for pressure in programs:
        assert pressure.max() <= tripod.pressure_max_pa and pressure.min() >= tripod.pressure_min_pa
        rate = np.abs(np.diff(pressure, axis=0)).max() / config.identification.dt_s
        assert rate <= tripod.slew_pa_per_s * (1 + 1e-9)
        assert (np.ptp(pressure, axis=0) > 0.2 * tripod.pressure_max_pa).all(), "every chamber moves"
        assert not pressure[0].any() and not pressure[-1].any()


def test_it_refuses_what_does_not_fit(everything: Stage, config: Config) -> None:
    policy, surrogate, calibration = everything.inputs
    driver = BenchDriver(everything.robot, everything.body, everything.noise)
    with pytest.raises(ArtifactError, match="task=dance"):
        pressing = replace(policy, task_name="dance")
        plant = (everything.body, chain_of(everything.robot, []))
        run(config, everything.robot, pressing, surrogate, calibration, *plant, driver, tracker=NullTracker())
    with pytest.raises(ArtifactError, match="chambers"):
        PolicyController(policy, surrogate, replace(calibration, pressure_mean=np.zeros(2)), Course.free("one", np.zeros((1, 3))))
    with pytest.raises(ConfigError, match="sessions=1"):
        replace(config.identification, sessions=1)
    with pytest.raises(ConfigError, match="command_rate_hz=0"):
        replace(config, command_rate_hz=0.0)


def test_what_would_be_found_out_late_is_refused_before_the_robot_moves(everything: Stage, config: Config) -> None:
    driver = BenchDriver(everything.robot, everything.body, everything.noise)
    plant = (everything.body, chain_of(everything.robot, []))
    faults = {
        "slew_pa_per_s": replace(config, bandwidth=replace(config.bandwidth, frequencies_hz=(1.0, 5.0, 7.0))),
        "below 2 Hz": replace(config, bandwidth=replace(config.bandwidth, dt_s=0.25)),
        "expected 3 or more": replace(config, disturbance=replace(config.disturbance, cut_s=1.0)),
    }
    for told, faulty in faults.items():
        with pytest.raises(ConfigError, match=told):
            run(faulty, everything.robot, *everything.inputs, *plant, driver, tracker=NullTracker())
    assert driver.entries == 0


def test_a_robot_that_is_weaker_or_hangs_otherwise_than_its_policy_is_refused(everything: Stage, config: Config) -> None:
    policy, *rest = everything.inputs
    pressing = replace(policy, task_name="hybrid", task=task_numbers("hybrid"))
    driver = BenchDriver(everything.robot, everything.body, everything.noise)
    for given, changes, error, told in (
        (pressing, {"tip_force_max_n": 0.5}, ConfigError, "task.force_max_n=2 is more than the tip is made for"),
        (policy, {"gravity_m_s2": (0.0, 0.0, 9.81)}, ArtifactError, "hangs in gravity .*rerun stage=surrogate"),
    ):
        other = replace(everything.robot, **changes)
        with pytest.raises(error, match=told):
            run(config, other, given, *rest, everything.body, chain_of(other, []), driver, tracker=NullTracker())
    assert driver.entries == 0
