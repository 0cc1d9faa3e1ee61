"""Laws of the surface before the tip, and of tasks on it."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.core.tracking import NullTracker
from softrl.effects.chain import Plant, chain_of
from softrl.effects.port import FORCE, FORCE_SLOPE, LOAD_PORT_ROWS, TIP
from softrl.rl.workspace import Workspace
from softrl.robots.robot import Robot
from softrl.sim2real.course import task_of
from softrl.sim2real.drivers.rig import Hardware, Noise, Rig, sample_of
from softrl.sim2real.stage import Config, run
from softrl.sim2real.surface import Surface, force_on_tip
from tests.sim2real.conftest import BenchDriver, task_numbers

TILT = np.deg2rad(15.0)
SURFACE = Surface((float(np.sin(TILT)), 0.0, -float(np.cos(TILT))), (0.0, 0.0, 0.17), 2000.0, 0.3)
NORMAL, ACROSS = np.array(SURFACE.normal), np.array([0.0, 1.0, 0.0])


def port_at(tip: np.ndarray, state: np.ndarray, robot: Robot, commit: bool = False) -> np.ndarray:
    port = np.zeros((LOAD_PORT_ROWS, 3))
    port[TIP] = tip
    type(SURFACE).kernel(SURFACE.pack(robot), state, port, 0.01, commit)
    return port


def test_it_pushes_out_in_proportion_to_depth_and_only_inside(tripod: Robot) -> None:
    point = np.array(SURFACE.point)
    inside, outside = point - 1e-3 * NORMAL, point + 1e-3 * NORMAL
    np.testing.assert_allclose(force_on_tip(SURFACE, tripod, np.zeros(4), inside), 2.0 * NORMAL, atol=1e-9)
    np.testing.assert_array_equal(force_on_tip(SURFACE, tripod, np.zeros(4), outside), 0.0)
    np.testing.assert_allclose(SURFACE.normal_force(np.stack([inside, outside])), [2.0, 0.0], atol=1e-9)


def test_friction_resists_sliding_up_to_its_limit(tripod: Robot) -> None:
    state = np.zeros(4)
    start = np.array(SURFACE.point) - 1e-3 * NORMAL
    port_at(start, state, tripod, commit=True)
    for slide_m in (1e-5, 1e-4, 5e-3):
        force = port_at(start + slide_m * ACROSS, state, tripod)[FORCE]
        grip = force - (force @ NORMAL) * NORMAL
        assert grip[1] < 0.0
        np.testing.assert_allclose(np.linalg.norm(grip), min(1000.0 * slide_m, 0.3 * 2.0), rtol=1e-6)
    port_at(start + 5e-3 * ACROSS, state, tripod, commit=True)
    back = port_at(start + 4.9e-3 * ACROSS, state, tripod)[FORCE]
    assert abs(back[1]) < 0.6, "after slipping it is held where it slipped to"


def test_its_slope_is_the_derivative_of_its_force_while_it_sticks(tripod: Robot) -> None:
    state = np.zeros(4)
    start = np.array(SURFACE.point) - 1e-3 * NORMAL
    port_at(start, state, tripod, commit=True)
    at = start + np.array([1e-5, 2e-5, -1e-5])
    slope = port_at(at, state, tripod)[FORCE_SLOPE : FORCE_SLOPE + 3]
    step = 1e-7
    numeric = np.stack(
        [(port_at(at + step * e, state, tripod) - port_at(at - step * e, state, tripod))[FORCE] / (2 * step)
         for e in np.eye(3)], axis=1,
    )  # fmt: skip
    np.testing.assert_allclose(slope, numeric, atol=1e-3 * np.abs(numeric).max())


def test_the_rig_feels_what_the_model_of_the_surface_says(tripod: Robot, body: Simulator, silence: Noise) -> None:
    # where friction holds the tip depends on how it came there
    smooth = replace(SURFACE, friction=0.0)
    hardware = Hardware(body, chain_of(tripod, []), silence, 100.0, 100.0, 10.0)
    rows, _ = Rig(hardware, (0, 0), smooth).advance(100, np.full((1, 3), 10e3))
    pressed = sample_of(rows[-1])
    plant = Plant(body, chain_of(tripod, [smooth]))
    motion = plant.simulate(0.01 * np.arange(1, 101), np.full((100, 3), 10e3))
    assert pressed.tip_force @ NORMAL > 0.5
    assert smooth.normal_force(motion.position[-1:])[0] == pytest.approx(pressed.tip_force @ NORMAL, rel=0.02)
    rows, _ = Rig(hardware, (0, 0)).advance(1, np.zeros((0, 3)))
    assert np.isnan(sample_of(rows[-1]).tip_force).all(), "without a surface there is no force sensor"


@pytest.mark.slow
def test_a_policy_on_a_slope_may_carry_the_gain_that_did_nothing_there(policy: Policy) -> None:
    now = replace(policy, task_name="hybrid", task=task_numbers("hybrid"))
    assert task_of(replace(now, task=now.task | {"feedback_gain": 0.8}), 20, 0.5) == task_of(now, 20, 0.5)
    with pytest.raises(ConfigError, match="unknown key"):
        task_of(replace(now, task=now.task | {"other_gain": 0.8}), 20, 0.5)


def test_a_task_on_a_slope_runs_and_feedback_mends_the_force(
    tripod: Robot, body: Simulator, silence: Noise, surrogate: Surrogate, policy: Policy, calibration: Calibration,
    config: Config,
) -> None:
    pressing = replace(
        policy, task_name="hybrid", task=task_numbers("hybrid"), position_centre=Workspace(surrogate).centre
    )
    tracker, driver = NullTracker(), BenchDriver(tripod, body, silence)
    longer = replace(config, shape_steps=10)
    done = run(
        longer, tripod, pressing, surrogate, calibration, body, chain_of(tripod, []), driver, tracker=tracker
    )
    for recording in done.recordings:
        assert recording.tip_force is not None, "the rig has a force sensor now"
    assert not [r for r in done.recordings if "identification" in r.name], "sessions are for free space"
    metrics = tracker.metrics
    assert metrics["hybrid_circle_planned_force_n"] < metrics["hybrid_circle_feedforward_force_n"]
    assert metrics["hybrid_circle_planned_mm"] < metrics["hybrid_circle_mm"]
