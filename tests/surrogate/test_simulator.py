"""The surrogate as a body: the simulator contract, and rest where f_SP says."""

import pickle
from xml.etree import ElementTree

import numpy as np
import pytest

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.robots.robot import Robot
from softrl.surrogate.dimensions import dimensions_of
from softrl.surrogate.simulator import SurrogateSimulator
from softrl.surrogate.twin import Twin
from softrl.surrogate.urdf import write_urdf

DT_S = 0.02


@pytest.fixture(scope="module")
def simulator(robot: Robot, surrogate: Surrogate) -> SurrogateSimulator:
    """Return the surrogate of the lumped body in PyBullet."""
    return SurrogateSimulator(robot, surrogate, 1.0, 24.0, 1.0)


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


def test_misuse_is_refused(simulator: SurrogateSimulator, robot: Robot) -> None:
    from dataclasses import replace

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
    with pytest.raises(SolverError, match="diverged"):
        simulator.world.advance(state._replace(velocity=np.full_like(state.velocity, 90.0)), np.ones(3), 0.08, None)
