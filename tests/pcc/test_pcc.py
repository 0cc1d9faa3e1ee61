"""Laws of the lumped body: kinematics, statics, energy, convergence, symmetry, units."""

import math
import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_bvp
from scipy.linalg import eigh
from scipy.optimize import approx_fprime, brentq
from scipy.spatial.transform import Rotation

from softrl.core.errors import ConfigError
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.payload import Payload
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.inertia import Inertia
from softrl.pcc.model import fill_shape
from softrl.pcc.pose import (
    SERIES_BELOW,
    squared_bend,
    stumpff,
    tip_motion,
    tip_orientation,
    tip_position,
    work_of_loads,
)
from softrl.pcc.simulator import PccSimulator, PccState
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"


@cache
def robot_named(name: str) -> Robot:
    return Robot(**yaml.safe_load((CONF / "robot" / f"{name}.yaml").read_text()))


def simulator(robot: Robot | None = None, **changed: Any) -> PccSimulator:
    data = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text()) | changed
    data.pop("_target_")
    return PccSimulator(robot or robot_named("tripod"), **data)


def pose(shape: np.ndarray, length: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    position, quaternion = np.empty(3), np.empty(4)
    tip_position(np.asarray(shape, dtype=float), length, position)
    tip_orientation(np.asarray(shape, dtype=float), quaternion)
    return position, quaternion


def shape_of(body: PccSimulator, state: PccState) -> np.ndarray:
    """Return bends, elongation and change of curvature (5,)."""
    shape = np.empty(5)
    fill_shape(body._model, state.coordinates, shape)
    return shape


def swings_of(body: PccSimulator) -> tuple[np.ndarray, np.ndarray]:
    """Return the squared frequencies (5,) 1/s^2 of the straight, weightless body, and the shapes (5, 5) that belong to them."""
    across = body.mass_scale * body.robot.mass_kg * body.robot.length_m**2
    inertia = across * np.diag([1 / 20, 1 / 20, 4 / np.pi**2, 13 / 1260, 13 / 1260])
    inertia[[0, 1, 3, 4], [3, 4, 0, 1]] = across / 45.0
    squared, shapes = eigh(np.diag([*body.stiffness, *body.stiffness[:2] / 3.0]), inertia)
    return squared, shapes


def kinetic(inertia: Inertia, y: np.ndarray, rate: np.ndarray) -> float:
    """Return the kinetic energy, J, as ``Inertia`` has it."""
    w, dw = (v[:2] + inertia.with_loss * v[3:] for v in (y, rate))
    square, along, speed = float(w @ w), float(w @ dw), float(dw @ dw)
    across = inertia.bending / (1.0 + inertia.across * square + inertia.across_more * square**2)
    inward = inertia.bending / (1.0 + inertia.inward * square)
    swung = across * speed + (inward - across) * along**2 / max(square, 1e-300)
    nearer = 1.0 + inertia.nearer * square + inertia.nearer_more * square**2
    stretch = inertia.beyond + inertia.reach / nearer
    nears = -2.0 * inertia.reach * (inertia.nearer + 2.0 * inertia.nearer_more * square) / nearer**2 * along
    slight = inertia.loss * rate[3:] @ rate[3:] + stretch * rate[2] ** 2 + (1.0 + y[2]) * rate[2] * nears
    return float(0.5 * ((1.0 + y[2]) ** 2 * swung + slight))


@pytest.mark.parametrize("x", [0.0, 1e-12, 1e-4, 0.1, 1.0, SERIES_BELOW * 0.999, SERIES_BELOW, 9.0])
def test_stumpffs_functions_match_their_integrals(x: float) -> None:
    s, weight = np.polynomial.legendre.leggauss(40)
    s, weight = 0.5 * (s + 1.0), 0.5 * weight
    expected = [weight @ ((1 - s) ** (n - 1) * np.cos(np.sqrt(x) * s)) / math.factorial(n - 1) for n in range(2, 9)]
    np.testing.assert_allclose(stumpff(x), expected, rtol=2e-12)


def backbone(shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the tip (3,) and the centre of mass (3,) of a backbone of unit length, by integration of its tangent."""
    s = ((np.arange(20000) + 0.5) / 20000)[:, None]
    lean = s * shape[:2] + (s - s * s) * shape[3:]
    tangent = Rotation.from_rotvec(np.hstack([-lean[:, 1:], lean[:, :1], 0.0 * s])).as_matrix()[:, :, 2]
    return (1.0 + shape[2]) * tangent.mean(axis=0), (1.0 + shape[2]) * ((1.0 - s) * tangent).mean(axis=0)


@pytest.mark.parametrize("bend", [(0.0, 0.0), (1e-9, 0.0), (1e-4, 2e-4), (0.3, -0.2), (-1.5, 2.0)])
def test_tip_is_the_end_of_the_integrated_backbone(bend: tuple[float, float]) -> None:
    for change in (np.zeros(2), np.array([0.02, -0.03])):
        position, quaternion = pose(np.array([*bend, 0.1, *change]), length=0.2)
        size = np.linalg.norm(change)
        far = 0.2 * size**2 / 60.0 * (size + np.hypot(*bend))  # what its square adds across the axis, its cube at all
        np.testing.assert_allclose(position, 0.2 * backbone(np.array([*bend, 0.1, *change]))[0], atol=1e-9 + far)
        turned = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        np.testing.assert_allclose(turned, Rotation.from_rotvec([-bend[1], bend[0], 0.0]).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("bend", [(0.0, 0.0), (0.4, -0.3), (-1.5, 2.0)])
def test_velocity_is_how_the_position_changes(bend: tuple[float, float]) -> None:
    shape, rate, found = np.array([*bend, 0.07, 0.2, -0.1]), np.random.default_rng(4).standard_normal(5), np.empty((2, 3))
    tip_motion(shape, 0.2, stumpff(squared_bend(shape)), rate, *found)
    ahead, behind = (pose(shape + step * rate, 0.2)[0] for step in (1e-5, -1e-5))
    np.testing.assert_allclose(found, [pose(shape, 0.2)[0], (ahead - behind) / 2e-5], atol=1e-8)


@pytest.mark.parametrize("bend", [(0.0, 0.0), (0.4, -0.3), (-1.5, 2.0)])
def test_loads_are_the_slopes_of_their_work(bend: tuple[float, float]) -> None:
    """Of the tip the position itself is differentiated; of the centre of mass, which is nowhere else, the integrated backbone."""
    rng = np.random.default_rng(3)
    shape, out = np.array([*bend, 0.07, 0.02, -0.01]), np.empty(5)
    for at_tip in (True, False):
        force = rng.standard_normal(3)
        weight, tip_force = (np.zeros(3), force) if at_tip else (force, np.zeros(3))
        work_of_loads(shape, 0.2, stumpff(squared_bend(shape)), *weight, *tip_force, out)
        slopes = []
        for step in 1e-4 * np.eye(5):
            apart = [pose(at, 0.2)[0] if at_tip else 0.2 * backbone(at)[1] for at in (shape + step, shape - step)]
            slopes.append(force @ (apart[0] - apart[1]) / 2e-4)
        square = 0.0 if at_tip else 2e-3 * np.hypot(*bend) + 1e-4  # first order in the change of curvature only
        np.testing.assert_allclose(out, slopes, atol=0.2 * np.linalg.norm(force) * (1e-8 + square))


def potential(body: PccSimulator, shape: np.ndarray, pressure: np.ndarray, force: np.ndarray) -> float:
    """Return elastic energy minus the work of pressures, weight and tip force, independently, J."""
    robot = body.robot
    tip, centre = (robot.length_m * point for point in backbone(shape))
    gravity = np.array(robot.gravity_m_s2)
    end = body.mass_scale * body.end_mass_kg
    mass = body.mass_scale * robot.mass_kg - end
    strain = body.strain_map @ shape[:3]
    work = robot.chamber_area_m2 * robot.length_m * pressure @ strain + mass * gravity @ centre
    work += (force + end * gravity) @ tip
    prestress = (mass / 2.0 + end) * gravity[2] * robot.length_m * shape[2]
    elastic = 0.5 * body.stiffness @ shape[:3] ** 2 + body.stiffness[0] * shape[3:] @ shape[3:] / 6.0
    return float(elastic - work + prestress)


@pytest.mark.parametrize(("gravity", "end"), [((0.0, 0.0, -9.81), 0.0), ((6.0, -3.0, 5.0), 0.0), ((3.0, -1.5, 2.5), 0.4)])
def test_equilibrium_is_a_minimum_of_the_potential(gravity: tuple[float, float, float], end: float) -> None:
    robot = replace(robot_named("tripod"), gravity_m_s2=gravity)
    body = simulator(robot, end_mass_kg=end * robot.mass_kg)
    pressure, force = np.array([3e4, -1e4, 5e3]), np.array([3.0, -2.0, 0.7])
    steps = 2000
    motion_state = body.reset()
    for _ in range(steps // 10):
        motion_state = body.step(motion_state, pressure, 0.1, force)
    q = shape_of(body, motion_state)
    assert np.hypot(q[0], q[1]) > 0.3 and np.hypot(q[3], q[4]) > 0.05
    gradient = approx_fprime(q, lambda v: potential(body, v, pressure, force), 1e-6)
    assert np.abs(gradient).max() < 1e-3 * np.abs(body.stiffness[0] * q[:2]).max(), (gradient, q)


def test_energy_decays_after_release_as_damping_says() -> None:
    """Damping takes ``c v^2`` a second, and half of the energy is motion: it decays by ``exp(-c t / m)`` along each coordinate.

    The loss comes while it moves, twice a turn, so that the energy swings about this by about the damping ratio.
    """
    body = simulator(replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0)), damping_s=2e-3)
    zero, dt = np.zeros(3), 2e-3
    state = body.equilibrium(np.array([1.5e3, 0.0, 5e2]))  # the law is that of small swings
    rest = potential(body, shape_of(body, body.reset()), zero, zero)
    squared, shapes = swings_of(body)
    per_s = body.damping_s * squared
    amplitude = np.linalg.solve(shapes, state.coordinates)
    share = squared * amplitude**2 / (squared @ amplitude**2)
    energy = []
    for _ in range(900):
        moving = kinetic(body._model.inertia, state.coordinates, state.velocity)
        energy.append(moving + potential(body, shape_of(body, state), zero, zero) - rest)
        state = body.step(state, zero, dt)
    energy, time = np.array(energy), dt * np.arange(900)
    assert (np.diff(energy) < 1e-7 * energy[0]).all(), np.diff(energy).max()
    law = energy[0] * np.exp(-np.outer(time, per_s)) @ share
    ratio = 0.5 * body.damping_s * np.sqrt(squared)
    swing = np.exp(-np.outer(time, per_s)) @ (share * ratio) * energy[0] / law
    assert (np.abs(energy / law - 1.0) < 1.5 * swing).all(), (energy / law).tolist()
    late = time > 0.3  # what swings faster has come to rest
    rate = -np.polyfit(time[late], np.log(energy[late]), 1)[0]
    np.testing.assert_allclose(rate, per_s[0], rtol=5e-3)


def test_a_swing_dies_out_as_fast_as_damping_says_at_a_coarse_step() -> None:
    """Implicit Euler's steps would nearly triple the damping ratio here, by half the step times the frequency."""
    body = simulator(replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0)), damping_s=4e-3)
    squared, shapes = swings_of(body)
    frequency = np.sqrt(squared[0])
    dt = 0.25 / frequency
    state = PccState(0.01 * shapes[:, 0] / np.abs(shapes[:, 0]).max(), np.zeros(5))
    swing = []
    for _ in range(200):
        state = body.step(state, np.zeros(3), dt)
        swing.append(np.linalg.solve(shapes, state.coordinates)[0])
    peaks = [abs(swing[k]) for k in range(1, 199) if abs(swing[k]) >= max(abs(swing[k - 1]), abs(swing[k + 1]))]
    per_half_turn = np.log(peaks[0] / peaks[6]) / 6.0
    ratio = per_half_turn / np.hypot(np.pi, per_half_turn)
    np.testing.assert_allclose(ratio, 0.5 * body.damping_s * frequency, rtol=0.05)


@pytest.mark.parametrize("effects", [(), (Payload(1.0),), (Viscoelasticity(0.5, 0.1, 0.0, 1.0),)], ids=["bare", "load", "wall"])
def test_error_falls_in_second_order_with_the_step(effects: tuple[Effect, ...]) -> None:
    body = simulator(damping_s=0.02)
    plant = Plant(body, chain_of(body.robot, effects))

    def tips(dt: float) -> np.ndarray:
        time = dt * np.arange(1, round(1.0 / dt) + 1)
        held = np.repeat(0.01 * np.arange(1, 101), round(0.01 / dt))  # pressures jump where they do at every step
        pressure = 2e4 * np.sin(6.0 * held)[:, None] ** 2 * [1.0, 0.5, 0.0]
        return plant.simulate(time, pressure).position[round(0.02 / dt) - 1 :: round(0.02 / dt)]

    coarse, middle, fine = tips(0.01), tips(0.005), tips(0.0025)
    order = np.log2(np.abs(coarse - middle).max() / np.abs(middle - fine).max())
    assert 1.8 < order < 2.3, order


@pytest.mark.parametrize("chambers", [2, 3, 4, 5])
def test_next_chamber_turns_the_tip(chambers: int) -> None:
    angles = tuple(float(a) for a in 20.0 + 360.0 / chambers * np.arange(chambers))
    body = simulator(replace(robot_named("tripod"), chamber_angle_deg=angles))
    time = 0.01 * np.arange(1, 201)
    turn = Rotation.from_euler("z", 360.0 / chambers, degrees=True)
    tips = []
    for i in range(chambers):
        pressure = np.zeros((200, chambers))
        pressure[:, i] = 2e4 * np.sin(time)
        tips.append(body.simulate(time, pressure).position)
    for one, after in pairwise(tips):
        np.testing.assert_allclose(turn.apply(one), after, atol=1e-9)
    assert tips[0][-1, :2] @ body.robot.chamber_direction[0] < -5e-3  # away from the chamber under pressure


def test_full_pressure_bends_and_elongates_as_configured() -> None:
    weightless = replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0))
    body = simulator(weightless, bend_at_full_pressure_rad=0.45, elongation_at_full_pressure=0.08)
    full = weightless.pressure_max_pa
    q = shape_of(body, body.equilibrium(np.array([full, 0.0, 0.0])))
    np.testing.assert_allclose(np.hypot(q[0], q[1]), 0.45, rtol=1e-9)
    q = shape_of(body, body.equilibrium(np.full(3, full)))
    np.testing.assert_allclose(q, [0.0, 0.0, 0.08, 0.0, 0.0], atol=1e-9)
    finger = simulator(
        replace(robot_named("single_chamber_finger"), gravity_m_s2=(0.0, 0.0, 0.0)),
        bend_at_full_pressure_rad=2.6,
    )
    state = finger.equilibrium(np.array([finger.robot.pressure_max_pa]))
    np.testing.assert_allclose(shape_of(finger, state), [2.6, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    assert finger.observe(state)[0][0] > 0.0  # its chamber lies towards -x


def test_one_chamber_stretches_a_body_whose_tip_shows_it() -> None:
    """An arc of the bend and the length that are configured, in any plane; one that shows its bend alone has none."""
    weightless = replace(robot_named("single_chamber_finger"), gravity_m_s2=(0.0, 0.0, 0.0), chamber_angle_deg=(120.0,))
    body = simulator(replace(weightless, output="tip_position"), bend_at_full_pressure_rad=1.3, elongation_at_full_pressure=0.05)
    state = body.equilibrium(np.array([weightless.pressure_max_pa]))
    radius, away = 1.05 * weightless.length_m / 1.3, np.deg2rad(120.0 + 180.0)
    side = radius * (1.0 - np.cos(1.3))
    expected = [side * np.cos(away), side * np.sin(away), radius * np.sin(1.3)]
    np.testing.assert_allclose(body.observe(state)[0], expected, atol=1e-9)
    assert "axial_stiffness_scale" in body.parameters
    assert "axial_stiffness_scale" not in simulator(weightless, elongation_at_full_pressure=0.05).parameters


def test_a_body_that_does_not_stretch_keeps_its_length() -> None:
    body = simulator(elongation_at_full_pressure=0.0)
    assert "axial_stiffness_scale" not in body.parameters
    position, _ = body.observe(body.equilibrium(np.full(3, 3.5e4)))
    np.testing.assert_allclose(position, [0.0, 0.0, body.robot.length_m], atol=2e-5 * body.robot.length_m)
    bent = shape_of(body, body.equilibrium(np.array([3.5e4, 0.0, 0.0])))
    assert np.hypot(bent[0], bent[1]) > 0.4 and abs(bent[2]) < 2e-5
    with pytest.raises(ConfigError, match="must not be negative"):
        simulator(elongation_at_full_pressure=-0.1)


def test_units_scale_as_they_must() -> None:
    """Lengths times 2 at equal density, modulus and pressure: angles stay, times double."""
    robot = replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0))
    larger = replace(
        robot,
        length_m=2 * robot.length_m,
        chamber_radius_m=2 * robot.chamber_radius_m,
        chamber_area_m2=4 * robot.chamber_area_m2,
        mass_kg=8 * robot.mass_kg,
    )
    time = 0.002 * np.arange(1, 501)
    pressure = 2e4 * np.sin(8.0 * time)[:, None] * [1.0, 0.2, -0.3]
    small = simulator(robot, damping_s=0.01).simulate(time, pressure)
    large = simulator(larger, damping_s=0.02).simulate(2.0 * time, pressure)
    np.testing.assert_allclose(large.position, 2.0 * small.position, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(large.quaternion, small.quaternion, atol=1e-8)


@pytest.mark.parametrize("end", [0.0, 0.2, 0.9])
def test_free_oscillation_has_the_first_frequency_of_a_rod(end: float) -> None:
    """Clamped at one end, a share of its mass at the other: the square of x times the root of E I / (m L^3), m along the rod.

    x is the smallest root of 1 + cos x cosh x + r x (cos x sinh x - sin x cosh x), r the end's mass over the rod's; without it
    1.87510.
    """
    robot = replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0))
    body = simulator(robot, damping_s=2e-4, end_mass_kg=end * robot.mass_kg)
    ratio = end / (1.0 - end)
    uneven = lambda x: math.cos(x) * math.sinh(x) - math.sin(x) * math.cosh(x)  # noqa: E731
    root = brentq(lambda x: 1.0 + math.cos(x) * math.cosh(x) + ratio * x * uneven(x), 0.3, 3.0)
    inertia = (1.0 - end) * robot.mass_kg * robot.length_m**2
    period = 2.0 * np.pi / root**2 * np.sqrt(inertia / body.stiffness[0])
    dt = period / 2000.0
    state, still = body.equilibrium(np.array([1e3, 0.0, 0.0])), np.zeros(3)
    state = body.step(state, np.zeros((3000, 3)), dt)  # until what swings faster has come to rest
    tip = []
    for _ in range(6000):
        state = body.step(state, still, dt)
        tip.append(body.observe(state)[0][1])
    crossings = np.flatnonzero(np.diff(np.sign(tip)) != 0)
    np.testing.assert_allclose(2.0 * dt * np.diff(crossings).mean(), period, rtol=6e-3)


def rod_under(force_n: np.ndarray, length: float, stiffness: float) -> np.ndarray:
    """Return the tip (2,) m, across and along, of an inextensible rod under a dead force (across, along), N, at its tip.

    Euler's elastica, solved as a boundary value problem; ``stiffness`` is E I over the length, J.
    """
    force = force_n * length / stiffness

    def slope(_: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.vstack([y[1], -force[0] * np.cos(y[0]) + force[1] * np.sin(y[0]), np.sin(y[0]), np.cos(y[0])])

    ends = lambda a, b: np.array([a[0], b[1], a[2], a[3]])  # noqa: E731
    return length * solve_bvp(slope, ends, np.linspace(0.0, 1.0, 100), np.zeros((4, 100)), tol=1e-8).sol(1.0)[2:]


@pytest.mark.parametrize(("load", "apart"), [((0.05, 0.0), 1e-3), ((0.5, 0.3), 5e-3), ((1.0, -0.5), 2e-2)])
def test_a_force_at_the_tip_bends_it_as_it_bends_a_rod(load: tuple[float, float], apart: float) -> None:
    """Up to half a radian, a dead force across and along the axis, in units of the stiffness over the length."""
    robot = replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0))
    body = simulator(robot, axial_stiffness_scale=1e6)
    force = np.array(load) * body.stiffness[0] / robot.length_m
    state = body.step(body.reset(), np.zeros((200, 3)), 0.05, np.tile([force[0], 0.0, force[1]], (200, 1)))
    expected = rod_under(force, robot.length_m, body.stiffness[0])
    moved = expected - [0.0, robot.length_m]
    found = body.observe(state)[0][[0, 2]] - [0.0, robot.length_m]
    assert np.linalg.norm(found - moved) < apart * np.linalg.norm(moved), (found, moved)


@pytest.mark.parametrize("ratio", [0.6, 1.5])
def test_a_rod_whose_stiffness_changes_bends_as_its_moments_say(ratio: float) -> None:
    """Small bends of a rod of E I (1 + u (1 - 2 s)): under a pressure its moment is even, under a force it falls to the tip."""
    robot = replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0))
    body = simulator(robot, stiffness_base_to_tip=ratio, axial_stiffness_scale=1e6)
    s = (np.arange(20000) + 0.5) / 20000
    softness = 1.0 / (1.0 + (ratio - 1.0) / (ratio + 1.0) * (1.0 - 2.0 * s))
    pressed = body.observe(body.equilibrium(np.array([2e3, 0.0, 0.0])))[0]
    even = simulator(robot, axial_stiffness_scale=1e6).equilibrium(np.array([2e3, 0.0, 0.0])).coordinates[:2]
    across = robot.length_m * np.linalg.norm(even) * np.mean(softness * (1.0 - s))
    np.testing.assert_allclose(np.linalg.norm(pressed[:2]), across, rtol=0.01)
    assert abs(across / (robot.length_m * np.linalg.norm(even) / 2.0) - 1.0) > 0.05
    force = 0.02 * body.stiffness[0] / robot.length_m
    state = body.step(body.reset(), np.zeros((200, 3)), 0.05, np.tile([force, 0.0, 0.0], (200, 1)))
    across = force * robot.length_m**2 / body.stiffness[0] * np.mean(softness * (1.0 - s) ** 2)
    np.testing.assert_allclose(body.observe(state)[0][0], across, rtol=0.01)


def test_a_rod_lying_down_sags_under_its_weight() -> None:
    """By w L^4 / (8 E I) of its tip, and ends with the slope w L^3 / (6 E I): small bends, an even load."""
    robot = replace(robot_named("tripod"), gravity_m_s2=(0.2, 0.0, 0.0))
    body = simulator(robot)
    position, quaternion = body.observe(body.reset())
    bend = robot.mass_kg * 0.2 * robot.length_m / body.stiffness[0]
    np.testing.assert_allclose(position[0], robot.length_m * bend / 8.0, rtol=1e-5)
    np.testing.assert_allclose(2.0 * np.arcsin(quaternion[2]), bend / 6.0, rtol=1e-5)


def test_stepping_is_simulating() -> None:
    body = simulator()
    time = 0.01 * np.arange(1, 101)
    pressure = 2e4 * np.random.default_rng(1).uniform(-1, 1, (100, 3))
    force = np.random.default_rng(2).normal(0, 0.5, (100, 3))
    motion = body.simulate(time, pressure, force)
    state = body.reset()
    for k in range(100):
        before = state.coordinates.copy()
        after = body.step(state, pressure[k], 0.01, force[k])
        np.testing.assert_array_equal(state.coordinates, before)
        state = after
        position, quaternion = body.observe(state)
        np.testing.assert_allclose(position, motion.position[k], atol=1e-9)
        np.testing.assert_allclose(quaternion, motion.quaternion[k], atol=1e-9)


def test_rest_of_an_upright_robot_is_its_length() -> None:
    body = simulator()
    position, quaternion = body.observe(body.reset())
    np.testing.assert_allclose(position, [0, 0, body.robot.length_m], atol=1e-9)
    np.testing.assert_allclose(quaternion, [1, 0, 0, 0], atol=1e-9)


def test_parameters_are_replaced_and_checked() -> None:
    body = simulator()
    softer = body.with_parameters(bending_stiffness_scale=0.5)
    assert softer.parameters["bending_stiffness_scale"] == 0.5 and body.parameters["bending_stiffness_scale"] == 1.0
    assert np.isclose(softer.stiffness[0], 0.5 * body.stiffness[0])
    assert "axial_stiffness_scale" not in simulator(robot_named("single_chamber_finger")).parameters
    with pytest.raises(ConfigError, match="no parameter youngs"):
        body.with_parameters(youngs=1.0)
    with pytest.raises(ConfigError, match="mass_scale=-1"):
        body.with_parameters(mass_scale=-1.0)
    with pytest.raises(ConfigError, match=r"axis=\+y: simulator pcc needs \+z"):
        simulator(replace(robot_named("tripod"), axis="+y"))


def cpu_ms(work: Callable[[], object], repeats: int = 7) -> float:
    """Return the least processor time of several calls, ms."""
    work()
    spent = []
    for _ in range(repeats):
        start = clock.process_time()
        work()
        spent.append(clock.process_time() - start)
    return 1e3 * min(spent)


def test_a_minute_is_simulated_in_milliseconds() -> None:
    body = simulator()
    time = 0.01 * np.arange(1, 6001)
    pressure = 2e4 * np.sin(np.outer(time, [1.0, 1.3, 0.7]))
    chain = chain_of(body.robot, [Lag(0.1, 0.2), Hysteresis(0.05, 0.02), Viscoelasticity(0.4, 2.0, 0.2, 20.0)])
    bare = cpu_ms(lambda: body.simulate(time, pressure))
    three = cpu_ms(lambda: Plant(body, chain).simulate(time, pressure))
    assert bare < 8.0, f"{bare:.1f} ms bare; about 2 ms on an idle core"
    assert three < 24.0, f"{three:.1f} ms with three effects; about 6 ms on an idle core"


def test_corrections_of_the_jacobian_do_not_change_the_solution() -> None:
    """The quick search and the careful one find the same motion, to what both are asked for."""
    body = simulator()
    time = 0.01 * np.arange(1, 401)
    pressure = 3e4 * np.sin(np.outer(time, [3.0, 2.0, 1.0]))
    coordinates = body.simulate(time, pressure).position
    state, last = body.reset(), []
    for row in pressure:  # every single step begins with a fresh Jacobian
        state = body.step(state, row, 0.01)
        last.append(body.observe(state)[0])
    np.testing.assert_allclose(coordinates, last, atol=2e-9)


def test_a_longer_body_is_that_of_a_longer_robot() -> None:
    robot = robot_named("tripod")
    longer = simulator(robot).with_parameters(length_scale=1.03)
    of_longer = simulator(replace(robot, length_m=1.03 * robot.length_m))
    poses = [body.observe(body.equilibrium(np.array([2e4, 5e3, 0.0]))) for body in (longer, of_longer)]
    for a, b in zip(*poses, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
    np.testing.assert_allclose(longer.stiffness, of_longer.stiffness)
