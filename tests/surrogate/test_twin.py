"""Equilibrium of the twin: forces balance, contact obeys its laws, PyBullet settles at the same place."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.surrogate import Surrogate
from softrl.core.tracking import NullTracker
from softrl.robots.robot import Robot
from softrl.surrogate.kinematics import chain_of
from softrl.surrogate.maps import PressureToJoints, evaluate, network, network_of
from softrl.surrogate.parity import SETTLING, parity, settle
from softrl.surrogate.report import draw_maps
from softrl.surrogate.springs import Springs, constant, softness_at, springs_of, stiffness_matrix
from softrl.surrogate.stage import build_surrogate
from softrl.surrogate.stiffness import Compliance, bending_of, chain_turn, fit_springs
from softrl.surrogate.twin import Plane, Twin, chain_compliance
from softrl.surrogate.world import World
from tests.surrogate.conftest import lumped_body, tiny_config

TILT = np.deg2rad(15.0)
NORMAL = np.array([np.sin(TILT), 0.0, -np.cos(TILT)])


@pytest.fixture(scope="module")
def pressed(surrogate: Surrogate) -> tuple[Twin, np.ndarray, Plane]:
    """Return commands whose free tips lie 1 to 6 mm behind a slope."""
    twin = Twin(surrogate)
    theta = surrogate.sample_joints[:6]
    centre = twin.tip(theta)
    depth = 1e-3 * np.arange(1, 7)
    aim = centre[:1] - depth[:, None] * NORMAL
    return twin, twin.joints_for_tip(aim), (NORMAL, centre[0])


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_joint_torques_balance_the_reaction(pressed: tuple[Twin, np.ndarray, Plane], friction: float) -> None:
    twin, theta, plane = pressed
    push = np.array([0.2, -0.1, 0.1])
    state = twin.solve(theta, push, plane, friction)
    command = np.tile(theta, (1, len(twin.chain.below)))
    for b in range(len(theta)):
        torque = twin.stiffness(theta[b]) @ (state.joints[b] - command[b])
        slope = _jacobian(twin, state.joints[b])
        np.testing.assert_allclose(torque, slope.T @ (push + state.reaction[b]), atol=1e-6)


def _jacobian(twin: Twin, q: np.ndarray) -> np.ndarray:
    from softrl.surrogate.kinematics import pose

    tip, rotation, jacobian = np.empty(3), np.empty((3, 3)), np.empty((3, len(q)))
    pose(q, twin.chain, tip, rotation, jacobian)
    return jacobian


def test_contact_force_is_penetration_times_stiffness_and_grows(pressed: tuple[Twin, np.ndarray, Plane]) -> None:
    twin, theta, plane = pressed
    state = twin.solve(theta, None, plane)
    depth = -(state.tip - plane[1]) @ plane[0]
    np.testing.assert_allclose(state.contact_force, twin.contact_stiffness * depth, atol=1e-6)
    assert (np.diff(state.contact_force) > 0).all() and (state.contact_force > 0).all()


def test_friction_stays_in_its_cone_and_sticks(pressed: tuple[Twin, np.ndarray, Plane]) -> None:
    twin, theta, plane = pressed
    normal, start = plane[0], np.tile(plane[1] + [2e-3, 1e-3, 0.0], (len(theta), 1))
    for friction in (0.05, 5.0):
        state = twin.solve(theta, None, plane, friction, start)
        across = state.reaction - (state.reaction @ normal)[:, None] * normal
        assert (np.linalg.norm(across, axis=1) <= friction * state.contact_force + 1e-9).all()
    slip = state.tip - start
    slip -= (slip @ normal)[:, None] * normal
    assert np.abs(slip).max() < 1e-6  # with a coefficient of 5 it sticks


def test_without_touch_there_is_no_force(surrogate: Surrogate) -> None:
    twin = Twin(surrogate)
    theta = surrogate.sample_joints[:4]
    state = twin.solve(theta, None, (NORMAL, np.array([0.0, 0.0, 1.0])), 0.3)
    np.testing.assert_array_equal(state.contact_force, 0.0)
    np.testing.assert_allclose(state.tip, twin.tip(theta), atol=1e-12)


def test_pybullet_settles_where_the_twin_is(surrogate: Surrogate) -> None:
    free, loaded = parity(surrogate, surrogate.sample_joints[:2], np.array([0.5, 0.5, -0.5]))
    assert free < 1e-6 and loaded < 1e-5, f"free {1e3 * free:g} mm, loaded {1e3 * loaded:g} mm"


def test_pybullet_presses_as_hard_as_the_twin(surrogate: Surrogate, pressed: tuple[Twin, np.ndarray, Plane]) -> None:
    _, theta, plane = pressed
    world, felt = World(surrogate, 1.0, SETTLING, 1.0), []
    world.place_plane(*plane, 0.0)
    for command in theta[[1, 4]]:
        settle(world, command)
        felt.append(world.contact_force())
    world.close()
    expected = Twin(surrogate).solve(theta[[1, 4]], None, plane).contact_force
    np.testing.assert_allclose(felt, expected, rtol=0.05)


def bent_springs(surrogate: Surrogate, taper: float) -> Springs:
    """Return springs that change with the pose, couple the joints and are softer near the base by ``taper``."""
    coefficients = constant(np.array([20.0, 25.0, 1e4]))
    coefficients[1:4, :3] = [[0.1, -0.2, 0.3], [0.2, 0.1, -0.3], [-0.3, 0.2, 0.1]]
    coefficients[1, 4], coefficients[2, 5] = 2e-3, -3e-3
    share = np.exp(-taper * np.linspace(-1.0, 1.0, surrogate.gaps))
    return Springs(coefficients, share / share.mean(), surrogate.joint_low, surrogate.joint_high)


def test_springs_are_found_again(surrogate: Surrogate) -> None:
    chain, theta = chain_of(surrogate), np.ascontiguousarray(surrogate.sample_joints[:60])
    truth = bent_springs(surrogate, 0.4)
    turn = chain_turn(theta, chain, truth)
    body = Compliance(chain_compliance(theta, chain, truth), turn)
    found = fit_springs(theta[::2], chain, Compliance(body.tip[::2], turn[::2]), truth.low, truth.high, 400, 1e-12)
    unseen = np.ascontiguousarray(theta[1::2])
    np.testing.assert_allclose(chain_compliance(unseen, chain, found), body.tip[1::2], atol=1e-3 * body.tip.max())
    np.testing.assert_allclose(found.share, truth.share, rtol=1e-2)


def test_softness_and_stiffness_belong_together(surrogate: Surrogate) -> None:
    springs = bent_springs(surrogate, 0.4)
    for theta in surrogate.sample_joints[:4]:
        soft, stiff = softness_at(theta, springs), stiffness_matrix(theta, springs)
        assert np.linalg.eigvalsh(soft).min() > 0.0
        np.testing.assert_allclose(soft, soft.T)
        np.testing.assert_allclose(stiff[3:6, 3:6] @ soft * springs.share[1], np.eye(3), atol=1e-9)


def test_an_orientation_turns_by_bending_and_twist(surrogate: Surrogate) -> None:
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(5, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = rng.normal(size=(5, 3, 3))
    np.testing.assert_allclose(np.einsum("si,sij->sj", axis, bending_of(turn, axis)), 0.0, atol=1e-12)


def test_pybullet_and_twin_agree_where_springs_change_with_the_pose(surrogate: Surrogate) -> None:
    springs = bent_springs(surrogate, 0.4)
    changed = replace(surrogate, softness_coefficients=springs.coefficients, gap_share=springs.share)
    free, loaded = parity(changed, surrogate.sample_joints[:2], np.array([0.5, -0.5, 0.5]))
    assert free < 1e-6 and loaded < 1e-5, f"free {1e3 * free:g} mm, loaded {1e3 * loaded:g} mm"


def test_a_surrogate_without_coefficients_has_one_stiffness(surrogate: Surrogate) -> None:
    plain = replace(surrogate, softness_coefficients=np.empty((0, 6)), gap_share=np.empty(0))
    for theta in surrogate.sample_joints[:3]:
        np.testing.assert_allclose(
            stiffness_matrix(theta, springs_of(plain)), np.diag(np.tile(surrogate.joint_stiffness, surrogate.gaps))
        )


def test_compliance_predicts_a_small_load(surrogate: Surrogate) -> None:
    twin, theta = Twin(surrogate), surrogate.sample_joints[:5]
    force = np.array([0.01, -0.02, 0.01])
    moved = twin.solve(theta, force).tip - twin.tip(theta)
    expected = twin.compliance(theta) @ force
    np.testing.assert_allclose(moved, expected, atol=2e-3 * np.abs(expected).max())


def test_the_map_beats_its_baselines_and_goes_round(surrogate: Surrogate, tracker: NullTracker) -> None:
    found = tracker.metrics
    assert (
        found["heldout/tip_error_mm"]
        < 0.5 * found["heldout/affine_tip_error_mm"]
        < 0.1 * found["heldout/mean_tip_error_mm"]
    )
    assert found["heldout/roundtrip_pressure_kpa"] < 0.1
    maps = PressureToJoints(surrogate)
    np.testing.assert_allclose(maps.joints(maps.pressure(surrogate.sample_joints)), surrogate.sample_joints, atol=5e-4)


def test_of_more_chambers_than_joints_other_pressures_for_the_same_joints_are_no_error(robot: Robot) -> None:
    four = replace(robot, name="four", chamber_angle_deg=(0.0, 90.0, 180.0, 270.0))
    made = build_surrogate(tiny_config(), four, None, lumped_body(four), four.length_m, NullTracker())
    assert not [name for name in made.metrics if name.endswith("pressure_kpa")]
    assert made.metrics["heldout/roundtrip_joint_angle_deg"] < 0.01
    assert len(draw_maps(made).axes) == 1


def test_the_compiled_network_is_the_network_and_its_slope_the_derivative(surrogate: Surrogate) -> None:
    x = np.random.default_rng(0).normal(size=(5, surrogate.chambers))
    compiled = network_of(surrogate.forward)
    for row in x:
        value, slope = evaluate(compiled, row, True)
        np.testing.assert_allclose(value, network(surrogate.forward, row[None])[0], atol=1e-12)
        for j in range(surrogate.chambers):
            nudge = 1e-6 * np.eye(surrogate.chambers)[j]
            ends = [network(surrogate.forward, (row + sign * nudge)[None])[0] for sign in (1.0, -1.0)]
            np.testing.assert_allclose(slope[j], (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_beyond_the_sampled_pressures_the_map_goes_on_as_it_was_going(surrogate: Surrogate) -> None:
    maps, low, high = PressureToJoints(surrogate), surrogate.pressure_low, surrogate.pressure_high
    edge = np.array([high[0], 0.5 * (low[1] + high[1]), low[2]])
    out, across = np.array([1e3, 0.0, -2e3]), np.array([0.0, 500.0, 0.0])
    inward = maps.joints(edge) - maps.joints(edge - 1e-3 * out)
    np.testing.assert_allclose(maps.joints(edge + out) - maps.joints(edge), 1e3 * inward, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(maps.joints(edge + 1e-9 * out), maps.joints(edge), atol=1e-9)
    both = maps.joints(np.stack([edge + out, edge + across, edge + out + across]))
    np.testing.assert_array_equal(both[1], maps.joints(edge + across)[0], "pressures in range are the network's alone")
    np.testing.assert_allclose(both[2], maps.joints(edge + out + across)[0], atol=1e-12)


def test_joints_out_of_reach_get_the_nearest_and_say_so(surrogate: Surrogate) -> None:
    maps = PressureToJoints(surrogate)
    inside = maps.joints(np.random.default_rng(1).uniform(surrogate.pressure_low, surrogate.pressure_high, (20, 3)))
    span = surrogate.joint_high - surrogate.joint_low
    assert np.abs(maps.invert(inside).miss / span).max() < 1e-6
    beyond = inside + 2.0 * span
    found = maps.invert(beyond)
    assert (np.abs(found.miss / span).max(axis=1) > 0.5).all()
    assert (found.pressure >= surrogate.pressure_low - 1e-6).all()
    assert (found.pressure <= surrogate.pressure_high + 1e-6).all()
    np.testing.assert_allclose(maps.joints(found.pressure) - beyond, found.miss, atol=1e-9)
