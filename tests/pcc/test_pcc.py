"""Laws of the constant-curvature body: kinematics, statics, energy, convergence, symmetry, units."""

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
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from softrl.core.errors import ConfigError
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.payload import Payload
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.pose import SERIES_BELOW, shape_functions, tip_pose
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


def pose(body: np.ndarray, length: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    position, quaternion = np.empty(3), np.empty(4)
    tip_pose(np.asarray(body, dtype=float), length, position, quaternion)
    return position, quaternion


@pytest.mark.parametrize("x", [0.0, 1e-12, 1e-4, 0.1, 1.0, SERIES_BELOW * 0.999, SERIES_BELOW, 9.0])
def test_shape_functions_match_their_integrals(x: float) -> None:
    s, weight = np.polynomial.legendre.leggauss(40)
    s, weight = 0.5 * (s + 1.0), 0.5 * weight
    b = np.sqrt(x)
    # f = int (1-s) cos(b s), g = int cos(b s), F = int (1-s)^2 / 2 cos(b s), all over 0..1
    even = np.cos(b * s)
    f, g, h, df, dg, dh = shape_functions(x)
    np.testing.assert_allclose(
        [f, g, h], [weight @ ((1 - s) * even), weight @ even, weight @ ((1 - s) ** 2 / 2 * even)], rtol=1e-12
    )
    odd = -(s**2) * np.sinc(b * s / np.pi)  # derivative of cos(b s) by b, over b
    expected = [weight @ ((1 - s) * odd), weight @ odd, weight @ ((1 - s) ** 2 / 2 * odd)]
    np.testing.assert_allclose([df, dg, dh], expected, rtol=1e-10)


@pytest.mark.parametrize("bend", [(0.0, 0.0), (1e-9, 0.0), (1e-4, 2e-4), (0.3, -0.2), (-1.5, 2.0)])
def test_tip_is_the_end_of_the_integrated_backbone(bend: tuple[float, float]) -> None:
    s = (np.arange(20000) + 0.5) / 20000
    rotvec = np.outer(s, [-bend[1], bend[0], 0.0])
    tangent = Rotation.from_rotvec(rotvec).as_matrix()[:, :, 2]
    position, quaternion = pose([*bend, 0.1], length=0.2)
    np.testing.assert_allclose(position, 0.22 * tangent.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(
        Rotation.from_quat(quaternion, scalar_first=True).as_matrix(),
        Rotation.from_rotvec([-bend[1], bend[0], 0.0]).as_matrix(),
        atol=1e-12,
    )


def potential(body: PccSimulator, q: np.ndarray, pressure: np.ndarray, force: np.ndarray) -> float:
    """Return elastic energy minus the work of pressures, weight and tip force, independently, J."""
    robot = body.robot
    bx, by, eps = q
    angle, length = np.hypot(bx, by), robot.length_m * (1 + eps)
    s = (np.arange(2000) + 0.5) / 2000
    across = np.stack([bx, by]) / max(angle, 1e-12)
    sag = length * np.where(angle > 1e-9, (1 - np.cos(angle * s)) / max(angle, 1e-12), 0.0)
    height = length * np.where(angle > 1e-9, np.sin(angle * s) / max(angle, 1e-12), s)
    centre = np.array([*(across * sag.mean()), height.mean()])
    tip = pose(q, robot.length_m)[0]
    gravity = np.array(robot.gravity_m_s2)
    mass = body.mass_scale * robot.mass_kg
    strain = body.strain_map @ q
    work = robot.chamber_area_m2 * robot.length_m * pressure @ strain + mass * gravity @ centre + force @ tip
    prestress = mass * gravity[2] * robot.length_m / 2.0 * eps
    return float(0.5 * body.stiffness @ q**2 - work + prestress)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (6.0, -3.0, 5.0)])
def test_equilibrium_is_a_minimum_of_the_potential(gravity: tuple[float, float, float]) -> None:
    body = simulator(replace(robot_named("tripod"), gravity_m_s2=gravity))
    pressure, force = np.array([3e4, -1e4, 5e3]), np.array([1.0, -0.5, 0.7])
    steps = 2000
    motion_state = body.reset()
    for _ in range(steps // 10):
        motion_state = body.step(motion_state, pressure, 0.1, force)
    q = motion_state.coordinates
    assert np.hypot(q[0], q[1]) > 0.3
    gradient = approx_fprime(q, lambda v: potential(body, v, pressure, force), 1e-6)
    assert np.abs(gradient).max() < 1e-4 * np.abs(body.stiffness * q).max(), gradient


def test_energy_decays_after_release_as_damping_says() -> None:
    """Damping takes ``c v^2`` a second, and half of the energy is motion: it decays by ``exp(-c t / m)`` along each coordinate.

    The loss comes while it moves, twice a turn, so that the energy swings about this by about the damping ratio.
    """
    body = simulator(damping_s=2e-3)
    zero, dt = np.zeros(3), 2e-3
    state = body.equilibrium(np.array([3e4, 0.0, 1e4]))
    rest = potential(body, body.reset().coordinates, zero, zero)
    inertia = body.mass_scale * body.robot.mass_kg * body.robot.length_m**2 * np.array([1 / 20, 1 / 20, 1 / 3])
    per_s = body.damping_s * body.stiffness / inertia
    stretch = potential(body, state.coordinates * [0.0, 0.0, 1.0], zero, zero) - rest
    energy = []
    for _ in range(900):
        energy.append(0.5 * inertia @ state.velocity**2 + potential(body, state.coordinates, zero, zero) - rest)
        state = body.step(state, zero, dt)
    energy, time = np.array(energy), dt * np.arange(900)
    assert (np.diff(energy) < 1e-7 * energy[0]).all(), np.diff(energy).max()
    law = (energy[0] - stretch) * np.exp(-per_s[0] * time) + stretch * np.exp(-per_s[2] * time)
    ratio = 0.5 * body.damping_s * np.sqrt(body.stiffness[0] / inertia[0])
    assert np.abs(energy / law - 1.0).max() < 1.5 * ratio, (energy / law).tolist()
    late = time > 0.3  # the elongation has come to rest
    rate = -np.polyfit(time[late], np.log(energy[late]), 1)[0]
    np.testing.assert_allclose(rate, per_s[0], rtol=5e-3)


def test_a_swing_dies_out_as_fast_as_damping_says_at_a_coarse_step() -> None:
    """Implicit Euler's steps would nearly triple the damping ratio here, by half the step times the frequency."""
    body = simulator(replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0)), damping_s=4e-3)
    frequency = np.sqrt(body.stiffness[0] / (body.robot.mass_kg * body.robot.length_m**2 / 20.0))
    dt = 0.25 / frequency
    state = PccState(np.array([0.01, 0.0, 0.0]), np.zeros(3))
    swing = []
    for _ in range(200):
        state = body.step(state, np.zeros(3), dt)
        swing.append(state.coordinates[0])
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
    q = body.equilibrium(np.array([full, 0.0, 0.0])).coordinates
    np.testing.assert_allclose(np.hypot(q[0], q[1]), 0.45, rtol=1e-9)
    q = body.equilibrium(np.full(3, full)).coordinates
    np.testing.assert_allclose(q, [0.0, 0.0, 0.08], atol=1e-9)
    finger = simulator(
        replace(robot_named("single_chamber_finger"), gravity_m_s2=(0.0, 0.0, 0.0)),
        bend_at_full_pressure_rad=2.6,
    )
    state = finger.equilibrium(np.array([finger.robot.pressure_max_pa]))
    np.testing.assert_allclose(state.coordinates, [2.6], rtol=1e-9)
    assert finger.observe(state)[0][0] > 0.0  # its chamber lies towards -x


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


def test_free_oscillation_has_the_period_of_mass_and_stiffness() -> None:
    body = simulator(replace(robot_named("tripod"), gravity_m_s2=(0.0, 0.0, 0.0)), damping_s=1e-5)
    inertia = body.robot.mass_kg * body.robot.length_m**2 / 20.0
    period = 2.0 * np.pi * np.sqrt(inertia / body.stiffness[0])
    dt = period / 2000.0
    tip = body.simulate(dt * np.arange(1, 9001), np.tile([1e3, 0.0, 0.0], (9000, 1))).position[:, 1]
    final = pose(body.equilibrium(np.array([1e3, 0.0, 0.0])).coordinates, body.robot.length_m)[0][1]
    crossings = np.flatnonzero(np.diff(np.sign(tip - final)) != 0)
    np.testing.assert_allclose(2.0 * dt * np.diff(crossings).mean(), period, rtol=2e-3)


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
    with pytest.raises(ConfigError, match="axis"):
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
