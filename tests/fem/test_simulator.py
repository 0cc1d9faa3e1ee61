"""The full model behind the Simulator contract."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.mesh import Mesh
from softrl.core.errors import ConfigError, SolverError
from softrl.effects.chain import chain_of
from softrl.effects.payload import Payload
from softrl.effects.stiffness_scale import StiffnessScale
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.fem import simulator as fem
from softrl.fem.simulator import FemSimulator
from tests.fem.bodies import box_robot

DT_S = 2e-3


@pytest.fixture(scope="module")
def simulator(box: Mesh) -> FemSimulator:
    return FemSimulator(
        robot=box_robot(2), mesh=box, law="stable_neo_hookean", moduli_pa=(2e5,), poisson=0.45, element_order=2,
        mean_dilatation=True, rayleigh_mass_per_s=0.0, rayleigh_stiffness_s=0.01, tolerance_m=1e-9,
        max_iterations=40, reuse_below=0.3, youngs_modulus_scale=1.0, damping_scale=1.0, mass_scale=1.0,
    )


def test_rest_sags_under_weight_and_stays(simulator: FemSimulator) -> None:
    state = simulator.reset()
    position, quaternion = simulator.observe(state)
    assert position[2] < simulator.model.rest_tip[2] - 1e-6
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    later = simulator.step(state, np.zeros(2), DT_S)
    assert np.abs(simulator.observe(later)[0] - position).max() < 1e-8


def test_a_held_pressure_settles_at_its_equilibrium(simulator: FemSimulator) -> None:
    pressure = np.array([2e3, 0.0])
    time = DT_S * np.arange(1, 61)
    motion = simulator.simulate(time, np.tile(pressure, (60, 1)))
    wanted = simulator.observe(simulator.equilibrium(pressure))[0]
    travel = np.abs(wanted - simulator.observe(simulator.reset())[0]).max()
    assert np.abs(motion.position[-1] - wanted).max() < 0.02 * travel
    assert (motion.pressure == pressure).all()


def test_a_step_leaves_its_state_alone_and_repeats(simulator: FemSimulator) -> None:
    state = simulator.reset()
    before = state.body.pose.position.copy()
    one, two = (simulator.step(state, np.array([1e3, 0.0]), DT_S) for _ in range(2))
    assert (state.body.pose.position == before).all()
    assert np.abs(one.body.pose.position - two.body.pose.position).max() < 1e-8


def test_parameters_can_be_replaced(simulator: FemSimulator) -> None:
    softer = simulator.with_parameters(youngs_modulus_scale=0.5)
    assert softer.parameters["youngs_modulus_scale"] == 0.5
    pressure = np.array([1e3, 0.0])
    moved = [
        np.linalg.norm(s.observe(s.equilibrium(pressure))[0] - s.observe(s.reset())[0]) for s in (simulator, softer)
    ]
    assert moved[1] == pytest.approx(2.0 * moved[0], rel=0.1)
    with pytest.raises(ConfigError, match="no parameter"):
        simulator.with_parameters(friction=1.0)


def test_effects_in_the_body_act_at_their_ports(simulator: FemSimulator) -> None:
    robot = simulator.robot
    time, pressure = DT_S * np.arange(1, 41), np.tile([1.5e3, 0.0], (40, 1))
    plain = simulator.simulate(time, pressure)
    loaded = chain_of(robot, [Payload(mass=0.5)])
    heavy = simulator.simulate(time, pressure, load=loaded.hooks("load"))
    assert heavy.position[-1, 2] < plain.position[-1, 2]
    stiff = chain_of(robot, [StiffnessScale(scale=1.3)])
    held = simulator.simulate(time, pressure, body=stiff.hooks("body"))
    travel = [np.linalg.norm(m.position[-1] - simulator.observe(simulator.reset())[0]) for m in (plain, held)]
    assert 0.65 < travel[1] / travel[0] < 0.9


def test_effects_act_inside_the_step_and_not_one_step_late(simulator: FemSimulator) -> None:
    # a scale of the elastic pressure without memory: halving the step must not move what a late reaction would
    stiff, pressure = chain_of(simulator.robot, [StiffnessScale(scale=2.0)]), np.array([3e3, 0.0])
    hooks, loads = stiff.hooks("body"), chain_of(simulator.robot, [Payload(mass=2.0)]).hooks("load")
    rest = simulator.reset()
    once = simulator.step(rest, pressure, 1e9, body=hooks, load=loads)
    again = simulator.step(simulator._still(once.body.pose), pressure, 1e9, body=hooks, load=loads)
    moved = np.abs(once.body.pose.position - rest.body.pose.position).max()
    assert np.abs(again.body.pose.position - once.body.pose.position).max() < 1e-5 * moved


def test_under_no_pressure_a_loaded_body_stands_still_beside_a_creeping_wall(simulator: FemSimulator) -> None:
    time, none = DT_S * np.arange(1, 7), np.zeros((6, 2))
    chain = chain_of(simulator.robot, [Payload(mass=1.0), Viscoelasticity(2.0, 0.1, 0.0, 20.0)])
    tip = simulator.simulate(time, none, body=chain.hooks("body"), load=chain.hooks("load")).position
    sag = tip[0] - simulator.observe(simulator.reset())[0]
    assert np.linalg.norm(sag) > 1e-5
    assert np.ptp(tip, axis=0).max() < 1e-4 * np.linalg.norm(sag)


def test_a_body_that_does_not_come_to_rest_is_told(simulator: FemSimulator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fem, "REST_STEPS", 1)  # from the weight's equilibrium to the payload's
    with pytest.raises(SolverError, match="not to rest in 1 rounds"):
        simulator.simulate(
            DT_S * np.arange(1, 3), np.zeros((2, 2)), load=chain_of(simulator.robot, [Payload(mass=1.0)]).hooks("load")
        )


def test_bad_scales_are_refused(simulator: FemSimulator) -> None:
    with pytest.raises(ConfigError, match="mass_scale"):
        replace(simulator, mass_scale=0.0)


def test_a_robot_along_another_axis_is_refused(simulator: FemSimulator) -> None:
    with pytest.raises(ConfigError, match="axis=-z: simulator fem needs"):
        replace(simulator, robot=replace(simulator.robot, axis="-z"))
