"""One contract for every body that needs no heavy artifact: what rollouts, rigs and diagnosis rely on."""

import copy
import pickle
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from softrl.core.config import build, build_target
from softrl.core.errors import ConfigError
from softrl.core.simulator import Hanging, Hook, Motion, Simulator
from softrl.effects.chain import chain_of
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.mount_tilt import MountTilt
from softrl.effects.payload import Payload
from softrl.effects.strain_stiffening import StrainStiffening
from softrl.effects.tether import Tether
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.fem.simulator import FemSimulator
from softrl.pod.simulator import RomSimulator
from softrl.robots.robot import Robot
from tests.fem.bodies import box_robot, hollow_box
from tests.pod.conftest import fitted

CONF = Path(__file__).parents[2] / "conf"
DT_S = 0.01


def tripod() -> Robot:
    """Return the default robot."""
    return build(yaml.safe_load((CONF / "robot" / "tripod.yaml").read_text()), Robot, "robot")


def configured(name: str, robot: Robot) -> Simulator:
    """Return the simulator of ``conf/simulator/<name>.yaml``."""
    node = yaml.safe_load((CONF / "simulator" / f"{name}.yaml").read_text())
    return build_target(node, "simulator", lambda hint: robot if hint is Robot else None)


SIMULATORS: dict[str, Callable[[], tuple[Robot, Simulator]]] = {
    "pcc": lambda: (tripod(), configured("pcc", tripod())),
    "pcc_one_chamber": lambda: _pcc_with(replace(tripod(), chamber_angle_deg=(-90.0,))),
    "pcc_four_chambers": lambda: _pcc_with(replace(tripod(), chamber_angle_deg=(0.0, 90.0, 180.0, 270.0))),
    "rom": lambda: _rom_of(3),
    "rom_one_chamber": lambda: _rom_of(1),
    "fem": lambda: _fem(),
}


def _fem() -> tuple[Robot, Simulator]:
    robot, box = replace(box_robot(2), pressure_max_pa=3e4), hollow_box(chambers=2)
    return robot, FemSimulator(
        robot=robot, mesh=box, law="stable_neo_hookean", moduli_pa=(2.7e4,), poisson=0.45, element_order=2,
        mean_dilatation=True, rayleigh_mass_per_s=0.0, rayleigh_stiffness_s=0.02, tolerance_m=1e-10, max_iterations=40,
        reuse_below=0.3, youngs_modulus_scale=1.0, damping_scale=1.0, mass_scale=1.0,
    )


def _rom_of(chambers: int) -> tuple[Robot, Simulator]:
    robot, _, model = fitted(chambers)
    return robot, RomSimulator(robot, model, youngs_modulus_scale=1.0, damping_scale=1.0, mass_scale=1.0)


def _pcc_with(robot: Robot) -> tuple[Robot, Simulator]:
    return robot, configured("pcc", robot)


@pytest.fixture(
    params=[pytest.param(name, marks=[pytest.mark.slow] * (name == "fem")) for name in SIMULATORS], scope="module"
)
def case(request: pytest.FixtureRequest) -> tuple[Robot, Simulator]:
    """Return each robot with its simulator in turn."""
    return SIMULATORS[request.param]()


def program(robot: Robot, steps: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Return (time, pressure) with steps and a ramp, at moderate pressures."""
    rng = np.random.default_rng(2)
    levels = rng.uniform(0.0, 0.5 * robot.pressure_max_pa, (4, robot.chambers))
    pressure = np.repeat(levels, -(-steps // 4), axis=0)[:steps]
    return DT_S * np.arange(1, steps + 1), pressure * np.linspace(0.5, 1.0, steps)[:, None]


def chain(
    simulator: Simulator, pressure: np.ndarray, force: np.ndarray | None = None, body: Sequence[Hook] = ()
) -> Motion:
    """Return the motion by one ``step`` after the other."""
    state, poses = simulator.reset(), []
    for k, row in enumerate(pressure):
        state = simulator.step(state, row, DT_S, None if force is None else force[k], body=body)
        poses.append(simulator.observe(state))
    position, quaternion = (np.stack(values) for values in zip(*poses, strict=True))
    return Motion(DT_S * np.arange(1, len(pressure) + 1), position, quaternion, pressure)


def arrays(state: Any) -> list[np.ndarray]:
    """Return the numbers in a state: an array, or a collection or dataclass of such."""
    if is_dataclass(state):
        state = [getattr(state, field.name) for field in fields(state)]
    return [a for part in state for a in arrays(part)] if isinstance(state, (tuple, list)) else [np.array(state)]


@pytest.mark.parametrize("loaded", [False, True])
def test_a_chain_of_steps_is_the_simulation(case: tuple[Robot, Simulator], loaded: bool) -> None:
    robot, simulator = case
    time, pressure = program(robot)
    force = np.tile([0.3, -0.2, 0.1], (len(time), 1)) if loaded else None
    whole, stepped = simulator.simulate(time, pressure, force), chain(simulator, pressure, force)
    np.testing.assert_allclose(stepped.position, whole.position, atol=1e-9)
    np.testing.assert_allclose(stepped.quaternion, whole.quaternion, atol=1e-8)


def test_a_chain_of_steps_carries_the_effects_along(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    time, pressure = program(robot)
    effects = chain_of(robot, [Viscoelasticity(0.4, 0.3, 0.0, 1.0), Hysteresis(0.05, 0.02)])
    whole = simulator.simulate(time, pressure, None, effects.hooks("body"))
    stepped = chain(simulator, pressure, body=effects.hooks("body"))
    np.testing.assert_allclose(stepped.position, whole.position, atol=1e-9)
    bare = simulator.simulate(time, pressure).position
    assert np.abs(whole.position - bare).max() > 1e-4


def test_effects_have_come_as_far_in_a_simulation_as_in_its_steps(case: tuple[Robot, Simulator]) -> None:
    """Who goes on from either finds the hooks' own states there."""
    robot, simulator = case
    time, pressure = program(robot, steps=20)
    effects = chain_of(robot, [Viscoelasticity(0.4, 0.3, 0.0, 1.0), Payload(0.2)])
    whole, stepped = ((effects.hooks("body"), effects.hooks("load")) for _ in range(2))
    simulator.simulate(time, pressure, None, *whole)
    state = effects.at_rest(simulator, stepped[1])
    for row in pressure:
        state = simulator.step(state, row, DT_S, None, *stepped)
    for (one,), (other,) in zip(whole, stepped, strict=True):
        assert np.abs(other.state).max() > 0.0
        np.testing.assert_allclose(one.state, other.state, rtol=1e-5, atol=1e-5 * np.abs(other.state).max())


def test_it_comes_to_rest_under_a_load_where_the_simulation_starts(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    effects = chain_of(robot, [Payload(0.2), Tether(stiffness_n_per_m=30.0, offset_x=0.2, offset_y=-0.2)])
    state, hooks, none = simulator.reset(), effects.hooks("load"), np.zeros(robot.chambers)
    for _ in range(500):
        state = simulator.step(state, none, DT_S, None, load=hooks)
    start = simulator.simulate(DT_S * np.arange(1, 3), np.zeros((2, robot.chambers)), None, (), effects.hooks("load"))
    sag = np.abs(start.position[0] - simulator.observe(simulator.reset())[0]).max()
    assert sag > 1e-5
    np.testing.assert_allclose(simulator.observe(state)[0], start.position[0], atol=0.02 * sag)


def test_it_steps_from_rest_under_a_load_as_it_simulates(case: tuple[Robot, Simulator]) -> None:
    """The wall sees strains from where it hangs, in both, and creeps nowhere before a pressure acts."""
    robot, simulator = case
    time, pressure = program(robot)
    pressure[:20] = 0.0
    pull = Tether(stiffness_n_per_m=30.0, offset_x=0.2, offset_y=-0.2, since_s=0.4, over_s=0.1)
    load = [MountTilt(0.3, -0.2), Payload(0.2), pull]
    wall = [StrainStiffening(2.0), Viscoelasticity(0.4, 0.3, 0.0, 1.0)] if isinstance(simulator, Hanging) else []
    effects, poses = chain_of(robot, [*load, *wall]), []
    whole = simulator.simulate(time, pressure, None, effects.hooks("body"), effects.hooks("load"))
    body, on_tip = effects.hooks("body"), effects.hooks("load")
    state = effects.at_rest(simulator, on_tip)
    rest = simulator.observe(state)
    for row in pressure:
        state = simulator.step(state, row, DT_S, None, body, on_tip)
        poses.append(simulator.observe(state))
    position, quaternion = (np.stack(values) for values in zip(*poses, strict=True))
    np.testing.assert_allclose(position, whole.position, atol=2e-8)
    np.testing.assert_allclose(quaternion, whole.quaternion, atol=1e-6)
    np.testing.assert_allclose(position[:20], np.tile(rest[0], (20, 1)), atol=1e-6)
    np.testing.assert_allclose(quaternion[0], rest[1], atol=1e-4)


def test_it_rests_under_zero_pressure(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    start, _ = simulator.observe(simulator.reset())
    motion = simulator.simulate(DT_S * np.arange(1, 101), np.zeros((100, robot.chambers)))
    drift = np.abs(motion.position - start).max()
    assert drift < 1e-6, f"drifts {1e3 * drift:g} mm in 1 s at rest"


def test_it_is_deterministic(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    time, pressure = program(robot)
    first, second = simulator.simulate(time, pressure), simulator.simulate(time, pressure)
    np.testing.assert_array_equal(first.position, second.position)
    np.testing.assert_array_equal(first.quaternion, second.quaternion)


def test_a_step_leaves_state_and_inputs_as_they_were(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    state = simulator.step(simulator.reset(), np.full(robot.chambers, 5e3), DT_S)
    before, kept = copy.deepcopy(arrays(state)), np.full(robot.chambers, 9e3)
    once = simulator.step(state, kept, DT_S)
    again = simulator.step(state, kept, DT_S)
    for old, now in zip(before, arrays(state), strict=True):
        np.testing.assert_array_equal(old, now)
    for one, two in zip(arrays(once), arrays(again), strict=True):
        np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(kept, np.full(robot.chambers, 9e3))


def test_it_reports_metres_and_unit_quaternions(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    time, pressure = program(robot)
    position, quaternion = simulator.observe(simulator.reset())
    assert position.shape == (3,) and quaternion.shape == (4,)
    assert 0.5 * robot.length_m < np.linalg.norm(position) < 1.5 * robot.length_m
    motion = simulator.simulate(time, pressure)
    assert motion.position.shape == (len(time), 3) and motion.quaternion.shape == (len(time), 4)
    np.testing.assert_allclose(np.linalg.norm(motion.quaternion, axis=1), 1.0, atol=1e-9)
    np.testing.assert_array_equal(motion.time, time)
    travel = np.linalg.norm(motion.position - position, axis=1).max()
    assert 1e-3 < travel < robot.length_m, f"half the pressure range moves the tip by {1e3 * travel:g} mm"


def test_parameters_go_round(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    time, pressure = program(robot)
    before = simulator.simulate(time, pressure).position
    assert simulator.parameters
    same = simulator.with_parameters(**simulator.parameters)
    assert same.parameters == simulator.parameters
    np.testing.assert_array_equal(same.simulate(time, pressure).position, before)
    for name, value in simulator.parameters.items():
        changed = simulator.with_parameters(**{name: 1.3 * value})
        assert changed.parameters[name] == pytest.approx(1.3 * value)
        difference = np.abs(changed.simulate(time, pressure).position - before).max()
        assert difference > 1e-7, f"{name} changes nothing"
    np.testing.assert_array_equal(simulator.simulate(time, pressure).position, before)


def test_an_unknown_parameter_is_refused(case: tuple[Robot, Simulator]) -> None:
    with pytest.raises(ConfigError, match="wobble"):
        case[1].with_parameters(wobble=1.0)


def test_it_travels_to_another_process(case: tuple[Robot, Simulator]) -> None:
    robot, simulator = case
    time, pressure = program(robot, 20)
    twin = pickle.loads(pickle.dumps(simulator))
    np.testing.assert_array_equal(
        twin.simulate(time, pressure).position, simulator.simulate(time, pressure).position
    )
