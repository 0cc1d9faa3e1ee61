"""What the stage asks of a body: a tip that moves in three directions, told under the weight that acts."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ConfigError, SolverError
from softrl.core.tracking import NullTracker
from softrl.robots.robot import Robot
from softrl.surrogate import motion
from softrl.surrogate.full_model import bullet_yielding
from softrl.surrogate.simulator import SurrogateSimulator
from softrl.surrogate.stage import build_surrogate, model_poses
from softrl.surrogate.stiffness import Poses
from tests.pod.conftest import fitted
from tests.surrogate.conftest import SOFTNESS_M_PER_N, lumped_body, tiny_config


@pytest.mark.parametrize(
    ("angles", "joint"), [((0.0, 180.0), "theta_x"), ((90.0, 270.0), "theta_y"), ((180.0,), "theta_x")]
)
def test_a_tip_in_a_plane_is_refused_by_the_joint_that_stands_still(
    robot: Robot, angles: tuple[float, ...], joint: str
) -> None:
    flat = replace(robot, name="flat", chamber_angle_deg=angles)
    with pytest.raises(ConfigError, match=f"robot flat: .* joint {joint} moves the tip by .*three directions"):
        build_surrogate(tiny_config(), flat, None, lumped_body(flat), flat.length_m, NullTracker())


@pytest.mark.parametrize("there", [(4e-3, 3e-3, -1e-3), (np.nan, np.nan, np.nan)])
def test_poses_in_which_a_push_takes_the_body_to_another_rest_are_left_out(
    robot: Robot, surrogate: Surrogate, there: tuple[float, ...], caplog: pytest.LogCaptureFixture
) -> None:
    """As near where a body falls over: what the ends of a push differ by there is no compliance, nor positive definite."""
    plain = lumped_body(robot)

    def leaning(loads: np.ndarray) -> Poses:
        over = (loads[:, :3].min(axis=1) > 2e4) & (loads[:, 3] > 0.0)
        return Poses(plain(loads).tip + np.where(over[:, None], there, 0.0), None)

    config = replace(tiny_config(), compliance_samples=192)
    made = build_surrogate(config, robot, None, leaning, robot.length_m, NullTracker())
    assert "in 6 of 192 poses the body goes over to another rest under 0.1 N" in caplog.text
    found, usual = ({a: one.metrics[f"heldout/tip_stiffness_{a}_pct"] for a in "xyz"} for one in (made, surrogate))
    assert all(found[a] < 1.5 * usual[a] for a in "xyz"), f"{found} beside {usual} per cent"
    with pytest.raises(SolverError, match=r"in 16 of 16 poses; expected 2 or more .* lower stage\.compliance_force_n"):
        falling = lambda loads: Poses(plain(loads).tip + np.where(loads[:, 3:4] > 0.0, there, 0.0), None)  # noqa: E731
        build_surrogate(tiny_config(), robot, None, falling, robot.length_m, NullTracker())


def test_a_robot_of_a_quarter_the_size_is_loaded_with_what_its_tip_is_made_for(robot: Robot) -> None:
    """One that yields by 60 mm/N, and whose tip is made for 0.02 N, does not hold half of what others are made for."""
    small = replace(robot, name="small", length_m=0.04, chamber_radius_m=0.01, mass_kg=0.005, tip_force_max_n=0.02)
    plain = lumped_body(small)

    def soft(loads: np.ndarray) -> Poses:
        return plain(loads * np.repeat([1.0, 25.0], [small.chambers, 3]))

    with pytest.raises(ConfigError, match=r"compliance_force_n=0.1 is more than .* robot.tip_force_max_n=0.02"):
        build_surrogate(tiny_config(), small, None, soft, small.length_m, NullTracker())
    config = replace(tiny_config(), compliance_force_n=1e-3)
    made = build_surrogate(config, small, None, soft, small.length_m, NullTracker(), rayleigh=(0.0, 0.02))
    assert made.metrics["heldout/bullet_parity_loaded_mm"] < 1e-3
    assert max(made.metrics[f"heldout/tip_stiffness_{a}_pct"] for a in "xyz") < 15.0
    yields = np.einsum("sii->si", bullet_yielding(made, np.zeros((1, small.chambers)), small.tip_force_max_n).yields[:, :3, :3])
    np.testing.assert_allclose(yields[0], 25.0 * SOFTNESS_M_PER_N, rtol=0.15)


def test_poses_without_weight_are_those_of_a_model_without() -> None:
    model = fitted(3)[2]
    give_rotation = np.zeros_like(model.give_rotation)
    give_rotation[:, 0] = 1e-3 * np.arange(1.0, 10.0)  # rad s^2/m
    heavy = replace(model, give_rotation=give_rotation)
    loads = np.array([[0.0] * 6, [1e4, 0.0, -5e3, 0.1, 0.0, 0.2]])
    found = model_poses(heavy, loads, np.zeros(3))
    expected = model_poses(replace(heavy, gravity_m_s2=np.zeros(3)), loads)
    np.testing.assert_allclose(found.tip, expected.tip, atol=1e-12)
    np.testing.assert_allclose(found.quaternion, expected.quaternion, atol=1e-12)


def test_answers_to_steps_of_pressure_are_told_beside_a_chain_that_is_there_at_once(
    robot: Robot, surrogate: Surrogate, monkeypatch: pytest.MonkeyPatch
) -> None:
    body, told = SurrogateSimulator(robot, surrogate, 1.0, 1.0, 1.0), []
    time = motion.DT_S * np.arange(1, 51)
    pressures = surrogate.sample_pressure[surrogate.heldout][: motion.STEPS]
    moved = np.stack([body.simulate(time, np.tile(p, (50, 1))).position for p in pressures])
    monkeypatch.setattr(motion, "body_steps", lambda *_: moved)
    for damping_s in (0.02, 0.03):  # as the body has it, and otherwise
        tracker = NullTracker()
        motion.report_motion(replace(surrogate, rayleigh_stiffness_s=damping_s), robot, fitted(3)[2], tracker)
        told.append(tracker.metrics)
    assert told[0]["heldout/step_mm"] < 1e-9 and told[0]["heldout/steps_count"] == motion.STEPS
    assert 1.0 < told[1]["heldout/step_mm"] < told[1]["heldout/at_once_step_mm"]


def test_a_body_that_nothing_acts_on_stays_where_it_hangs() -> None:
    model, gravity = fitted(3)[2], (1.0, 0.0, 9.0)
    tips = motion.body_steps(model, np.array([[0.0, 0.0, 0.0], [5e3, 0.0, 0.0]]), 30, gravity)
    still = model_poses(model, np.zeros((1, 6)), np.array(gravity)).tip
    np.testing.assert_allclose(tips[0], np.tile(still, (30, 1)), atol=1e-6)
    assert np.linalg.norm(tips[1, -1] - still) > 1e-5
