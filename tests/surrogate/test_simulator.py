"""The surrogate as a body: the simulator contract, and rest where f_SP says."""

import pickle
from dataclasses import replace
from itertools import permutations, product
from xml.etree import ElementTree

import numpy as np
import pybullet as bullet
import pytest
from scipy.linalg import eigh

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.effects.chain import Plant, chain_of, simulate_batch
from softrl.effects.lag import Lag
from softrl.robots.robot import Robot
from softrl.surrogate.dimensions import dimensions_of
from softrl.surrogate.simulator import SurrogateSimulator
from softrl.surrogate.twin import Twin
from softrl.surrogate.urdf import write_urdf
from softrl.surrogate.world import Rayleigh, World

DT_S = 0.02


@pytest.fixture(scope="module")
def simulator(robot: Robot, surrogate: Surrogate) -> SurrogateSimulator:
    """Return the surrogate of the lumped body in PyBullet."""
    return SurrogateSimulator(robot, surrogate, 1.0, 1.0, 1.0)


def test_it_settles_where_the_map_says(simulator: SurrogateSimulator) -> None:
    pressure = np.tile([2e4, 5e3, -5e3], (60, 1))
    motion = simulator.simulate(DT_S * np.arange(1, 61), pressure)
    expected = Twin(simulator.surrogate).tip(simulator.joint_targets(pressure[:1]))[0]
    assert np.linalg.norm(motion.position[-1] - expected) < 2e-4  # 1.2 s after the step
    assert np.linalg.norm(motion.position[0] - expected) > 5e-3


def test_steps_make_the_simulation_and_travel(simulator: SurrogateSimulator) -> None:
    pressure = np.random.default_rng(0).uniform(0, 2e4, (8, 3))
    whole = simulator.simulate(DT_S * np.arange(1, 9), pressure)
    twin = pickle.loads(pickle.dumps(simulator))
    state = twin.reset()
    for k, row in enumerate(pressure):
        state = twin.step(state, row, DT_S)
        np.testing.assert_allclose(twin.observe(state)[0], whole.position[k], atol=1e-9)


def test_a_stiffer_body_bends_less(simulator: SurrogateSimulator) -> None:
    stiff = simulator.with_parameters(youngs_modulus_scale=2.0)
    pressure = np.array([[2e4, 0.0, 0.0]])
    np.testing.assert_allclose(stiff.joint_targets(pressure), simulator.joint_targets(0.5 * pressure))


def test_a_softer_body_bends_further_than_the_sampled_pressures_do(robot: Robot, simulator: SurrogateSimulator) -> None:
    """The joints of the lumped body are nearly in proportion to the pressure, whatever its size."""
    soft, pressure = simulator.with_parameters(youngs_modulus_scale=0.75), np.array([[robot.pressure_max_pa, 0.0, 0.0]])
    rest, full = (simulator.joint_targets(share * pressure) for share in (0.0, 1.0))
    further = np.linalg.norm(soft.joint_targets(pressure) - rest) / np.linalg.norm(full - rest)
    assert further == pytest.approx(1.0 / 0.75, rel=0.1), f"{further:.2f} times as far"


def test_a_mode_dies_out_by_the_bodys_rayleigh_damping(simulator: SurrogateSimulator) -> None:
    world, theta, (alpha, beta) = simulator.world, np.zeros(3), (1.5, 0.02)
    damped = World(simulator.surrogate, 1.0, Rayleigh(alpha, beta), 1.0)
    rest = damped.at_rest(theta)
    mass = np.array(bullet.calculateMassMatrix(damped.body, rest.coordinates.tolist(), physicsClientId=damped._client))
    squared, modes = eigh(world.stiffness(theta), mass)
    omega, rate = np.sqrt(squared[0]), 0.5 * (alpha + beta * squared[0])
    state, dt_s, steps = rest._replace(coordinates=1e-3 * modes[:, 0]), 2e-4, 400
    for _ in range(steps):
        state = damped.advance(state, theta, dt_s, None)
    damped.close()
    time, pace = dt_s * steps, np.sqrt(omega**2 - rate**2 + 0j)
    expected = (np.exp(-rate * time) * (np.cos(pace * time) + rate / pace * np.sin(pace * time))).real
    found = modes[:, 0] @ mass @ state.coordinates / 1e-3
    assert found == pytest.approx(expected, abs=0.01), f"{found:.3f} for {expected:.3f}; {omega:.1f} rad/s"
    assert abs(expected - 1.0) > 0.1


def test_jumps_between_all_limits_are_simulated(simulator: SurrogateSimulator, robot: Robot) -> None:
    low, high = robot.pressure_min_pa, robot.pressure_max_pa
    corners = simulator.joint_targets(np.array(list(product((low, high), repeat=3))))
    for start, end in permutations(corners, 2):
        state = simulator.world.at_rest(start)
        for _ in range(3):
            state = simulator.world.advance(state, end, 0.01, None)


@pytest.fixture
def hanging(robot: Robot, surrogate: Surrogate) -> SurrogateSimulator:
    """Return the surrogate as if its body had been bent by weight."""
    gravity = (2.0, -1.0, -9.0)
    heavy = replace(robot, gravity_m_s2=gravity)
    return SurrogateSimulator(heavy, replace(surrogate, gravity_m_s2=gravity), 1.0, 1.0, 1.0)


def test_a_body_as_much_heavier_as_stiffer_hangs_where_it_did(hanging: SurrogateSimulator) -> None:
    rest = hanging.reset().coordinates
    np.testing.assert_array_equal(hanging.with_parameters(youngs_modulus_scale=1.5, mass_scale=1.5).reset().coordinates, rest)
    assert np.abs(hanging.with_parameters(mass_scale=1.5).reset().coordinates - rest).max() > 1e-3


@pytest.mark.parametrize(("stiffness", "mass"), [(1.0, 1.4), (1.6, 1.0), (0.8, 1.2)])
def test_weight_beyond_what_the_commands_contain_is_carried_by_the_springs(
    hanging: SurrogateSimulator, stiffness: float, mass: float
) -> None:
    changed = hanging.with_parameters(youngs_modulus_scale=stiffness, mass_scale=mass)
    world, theta, rest = changed.world, changed.joint_targets(np.zeros((1, 3)))[0], changed.reset()
    links, client = range(bullet.getNumJoints(world.body, physicsClientId=world._client)), world._client
    weight = [bullet.getDynamicsInfo(world.body, i, physicsClientId=client)[0] / mass for i in links]

    def raised(q: np.ndarray) -> float:
        """Return the work (J) of the weight that is more, from where the links' centres are."""
        world.pose(rest._replace(coordinates=q))
        states = bullet.getLinkStates(world.body, list(links), computeForwardKinematics=1, physicsClientId=client)
        centres = np.array([state[0] for state in states])
        return float((mass - stiffness) * np.array(weight) @ centres @ np.array(changed.surrogate.gravity_m_s2))

    q, h = rest.coordinates, 1e-5
    pull = np.array([(raised(q + h * e) - raised(q - h * e)) / (2.0 * h) for e in np.eye(len(q))])
    np.testing.assert_allclose(world.stiffness(theta) @ (q - np.tile(theta, len(q) // 3)), pull, atol=1e-4)
    after = world.advance(rest, theta, 0.3, None)
    np.testing.assert_allclose(after.coordinates, q, atol=1e-5)


def test_another_gravity_is_refused(simulator: SurrogateSimulator, robot: Robot) -> None:
    with pytest.raises(ArtifactError, match=r"hangs in gravity \[0.0, 0.0, 0.0\] m/s\^2, but .*9.81.*rerun stage=surrogate"):
        replace(simulator, robot=replace(robot, gravity_m_s2=(0.0, 0.0, 9.81)))


def test_threads_share_a_world_without_mixing_motions(simulator: SurrogateSimulator, robot: Robot) -> None:
    time, command = DT_S * np.arange(1, 21), np.repeat(np.random.default_rng(0).uniform(-1e4, 3e4, (4, 3)), 5, axis=0)
    plants = [Plant(simulator, chain_of(robot, (Lag(fill_s=a, vent_s=a),))) for a in (0.05, 0.1, 0.2, 0.4)]
    one, four = (simulate_batch(plants, time, command, workers=workers) for workers in (1, 4))
    for first, second in zip(one, four, strict=True):
        np.testing.assert_array_equal(first.position, second.position)


def test_misuse_is_refused(simulator: SurrogateSimulator, robot: Robot) -> None:
    with pytest.raises(ConfigError, match="wobble"):
        simulator.with_parameters(wobble=1.0)
    with pytest.raises(ArtifactError, match="rerun stage=surrogate"):
        replace(simulator, robot=replace(robot, name="other"))
    with pytest.raises(ConfigError, match="body and load"):
        simulator.step(simulator.reset(), np.zeros(3), DT_S, body=[object()])  # type: ignore[list-item]


@pytest.mark.parametrize("mass_kg", [0.006, 0.012, 0.04, 1.1])
def test_the_links_of_a_light_robot_weigh_what_it_weighs(robot: Robot, mass_kg: float) -> None:
    chain = dimensions_of(robot, None, robot.length_m, 6)
    urdf = ElementTree.fromstring(write_urdf("light", chain, mass_kg, -np.ones(3), np.ones(3), 0.005))
    mass = {link.attrib["name"]: float(link.find("inertial/mass").attrib["value"]) for link in urdf.iter("link")}
    assert min(mass.values()) > 0.0
    assert sum(mass.values()) - mass["base"] - mass["tip"] == pytest.approx(mass_kg)
    assert mass["tip"] < 0.04 * mass_kg


def test_jumps_settle(simulator: SurrogateSimulator) -> None:
    s, world, state = simulator.surrogate, simulator.world, simulator.reset()
    for theta in np.random.default_rng(0).choice(s.sample_joints, 60):
        state = world.advance(state, theta, 0.08, None)
    for _ in range(15):
        state = world.advance(state, s.sample_joints[0], 0.08, None)
    np.testing.assert_allclose(world.pose(state)[0], Twin(s).tip(s.sample_joints[0])[0], atol=1e-6)


def test_what_runs_away_is_refused(simulator: SurrogateSimulator) -> None:
    state = simulator.reset()
    with pytest.raises(SolverError, match="expected less than 99, where PyBullet cuts speeds off"):
        simulator.world.advance(state._replace(velocity=np.full_like(state.velocity, 90.0)), np.ones(3), 0.08, None)
