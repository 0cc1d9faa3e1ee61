"""The reduced body as a Simulator, and effects inside its step."""

import dataclasses
import logging
import pickle
from collections.abc import Callable
from typing import Any

import numba as nb
import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.simulator import Hook
from softrl.effects.effect import PORT_KERNEL
from softrl.effects.port import (
    ADDED,
    ADDED_SLOPE,
    ELASTIC,
    ELASTIC_SLOPE,
    FORCE,
    FORCE_SLOPE,
    GRAVITY,
    REST,
    STRAIN,
    TIP,
)
from softrl.pod.simulator import RomSimulator
from softrl.pod.step import reach
from softrl.robots.robot import Robot
from tests.pod.conftest import fitted
from tests.pod.synthetic import law_of

Body = tuple[Robot, Snapshots, ReducedModel]
DT_S = 0.01


@nb.njit(PORT_KERNEL, cache=True)
def spring_kernel(parameters: Any, state: Any, port: Any, dt: float, commit: bool) -> None:
    """Resist strain by ``parameters[0]`` times the stiffness scale; count the commits."""
    for i in range(port.shape[1]):
        port[ADDED, i] += parameters[0] * port[REST, i] * port[STRAIN, i]
        port[ADDED_SLOPE, i] += parameters[0] * port[REST, i]
    if commit:
        state[0] += 1.0


@nb.njit(PORT_KERNEL, cache=True)
def stiffer_kernel(parameters: Any, state: Any, port: Any, dt: float, commit: bool) -> None:
    """Add ``parameters[0]`` times the elastic pressure."""
    for i in range(port.shape[1]):
        port[ADDED, i] += parameters[0] * port[ELASTIC, i]
        port[ADDED_SLOPE, i] += parameters[0] * port[ELASTIC_SLOPE, i]


@nb.njit(PORT_KERNEL, cache=True)
def tether_kernel(parameters: Any, state: Any, port: Any, dt: float, commit: bool) -> None:
    """Pull by a constant force (3) and a spring of ``parameters[3]`` N/m to the point ``parameters[4:7]``."""
    for i in range(3):
        port[FORCE, i] += parameters[i] - parameters[3] * (port[TIP, i] - parameters[4 + i])
        port[FORCE_SLOPE + i, i] -= parameters[3]


@nb.njit(PORT_KERNEL, cache=True)
def tilt_kernel(parameters: Any, state: Any, port: Any, dt: float, commit: bool) -> None:
    """Replace gravity by ``parameters[:3]``."""
    for i in range(3):
        port[GRAVITY, i] = parameters[i]


def hook(kernel: Any, *parameters: float) -> Hook:
    return Hook(kernel, np.array(parameters), np.zeros(3))


def simulator(body: Body) -> RomSimulator:
    return RomSimulator(body[0], body[2], 1.0, 1.0, 1.0)


def program(robot: Robot, steps: int = 80) -> tuple[np.ndarray, np.ndarray]:
    levels = np.random.default_rng(2).uniform(0.0, 0.5 * robot.pressure_max_pa, (4, robot.chambers))
    return DT_S * np.arange(1, steps + 1), np.repeat(levels, steps // 4, axis=0)


def settle(sim: RomSimulator, pressure: np.ndarray, **hooks: Any) -> np.ndarray:
    """Return the coordinates z (n + 3,) after 4 s under ``pressure`` (n,) Pa."""
    state = sim.reset()
    for _ in range(200):
        state = sim.step(state, pressure, 0.02, None, **hooks)
    return state.coordinates


def test_a_chain_of_steps_is_the_simulation(body: Body) -> None:
    sim, (time, pressure) = simulator(body), program(body[0])
    force = np.tile([0.3, -0.2, 0.1], (len(time), 1))
    whole, state = sim.simulate(time, pressure, force), sim.reset()
    for k in range(len(time)):
        state = sim.step(state, pressure[k], DT_S, force[k])
        position, quaternion = sim.observe(state)
        np.testing.assert_allclose(position, whole.position[k], atol=1e-9)
        np.testing.assert_allclose(quaternion, whole.quaternion[k], atol=1e-8)


def test_it_rests_under_its_weight(body: Body) -> None:
    sim = simulator(body)
    start, _ = sim.observe(sim.reset())
    motion = sim.simulate(DT_S * np.arange(1, 101), np.zeros((100, body[0].chambers)))
    assert np.abs(motion.position - start).max() < 1e-8
    assert np.linalg.norm(start - body[2].rest_tip) > 1e-5, "no weight"
    np.testing.assert_allclose(np.linalg.norm(motion.quaternion, axis=1), 1.0, atol=1e-12)


def test_parameters_are_physics(tripod: Body) -> None:
    sim, pressure = simulator(tripod), np.array([1e4, 0.0, 0.0])
    light = sim.with_parameters(mass_scale=1e-6)
    half, double = (
        settle(light.with_parameters(youngs_modulus_scale=scale), scale * pressure)[3:] for scale in (0.5, 2.0)
    )
    np.testing.assert_allclose(half, double, atol=1e-8)  # modulus over pressure alone matters without weight
    time, held = DT_S * np.arange(1, 21), np.tile(pressure, (20, 1))
    reach = [
        np.ptp(sim.with_parameters(damping_scale=scale).simulate(time, held).position[:, 1])
        for scale in (0.1, 1.0, 10.0)
    ]
    assert reach[0] > reach[1] > reach[2]
    with pytest.raises(ConfigError, match="wobble"):
        sim.with_parameters(wobble=1.0)
    with pytest.raises(ConfigError, match="mass_scale=0"):
        sim.with_parameters(mass_scale=0.0)


def test_it_travels_and_is_deterministic(tripod: Body) -> None:
    sim, (time, pressure) = simulator(tripod), program(tripod[0], 20)
    before = sim.simulate(time, pressure).position
    twin = pickle.loads(pickle.dumps(sim))
    np.testing.assert_array_equal(twin.simulate(time, pressure).position, before)


def test_another_robots_model_is_refused(tripod: Body) -> None:
    with pytest.raises(ArtifactError, match="3 chambers"):
        RomSimulator(fitted(2)[0], tripod[2], 1.0, 1.0, 1.0)
    with pytest.raises(ConfigError, match="axis=-z: simulator rom needs \\+z; turn chambers and gravity instead"):
        RomSimulator(dataclasses.replace(tripod[0], axis="-z"), tripod[2], 1.0, 1.0, 1.0)


@pytest.mark.parametrize("kernel_name", ["spring", "stiffer"])
def test_added_pressure_is_in_balance(body: Body, kernel_name: str) -> None:
    robot, snapshots, model = body
    n, law, sim = model.chambers, law_of(robot), simulator(body)
    rest, pressure = sim.reset().coordinates, np.linspace(8e3, -4e3, n)
    kernel = spring_kernel if kernel_name == "spring" else stiffer_kernel
    z = settle(sim, pressure, body=[hook(kernel, 0.8)])
    bare = law.gradient(z)[:n] - law.gradient(rest)[:n]  # the weight acts on the tip alone here
    if kernel_name == "spring":
        scale = np.diag(np.linalg.inv(np.linalg.inv(law.hessian(np.zeros(n + 3)))[:n, :n])) * model.rest_volume
        added = 0.8 * scale * (z - rest)[:n] / model.rest_volume
    else:
        added = 0.8 * bare
    np.testing.assert_allclose(bare + added, pressure, rtol=1e-4, atol=2.0)


def test_a_hook_is_committed_once_a_step(tripod: Body) -> None:
    sim, (time, pressure) = simulator(tripod), program(tripod[0], 20)
    counting = hook(spring_kernel, 0.5)
    sim.step(sim.reset(), pressure, time[1] - time[0], None, [counting])
    assert counting.state[0] == len(time)


def test_a_force_by_hook_is_the_tip_force(body: Body) -> None:
    sim, (time, pressure) = simulator(body), program(body[0])
    force = np.array([0.4, -0.3, -0.2])
    state, hooked = sim.reset(), sim.reset()
    pull = [hook(tether_kernel, *force, 0.0, 0.0, 0.0, 0.0)]
    for row in pressure[:30]:
        state = sim.step(state, row, DT_S, force)
        hooked = sim.step(hooked, row, DT_S, None, load=pull)
        np.testing.assert_allclose(hooked.coordinates, state.coordinates, atol=1e-10)
    motion = sim.simulate(time, np.zeros_like(pressure), None, (), pull)
    assert np.ptp(motion.position, axis=0).max() < 1e-8, "a payload is there from the beginning"


def test_a_stiff_spring_at_the_tip_holds_it(body: Body) -> None:
    sim = simulator(body)
    start, _ = sim.observe(sim.reset())
    hold = [hook(tether_kernel, 0.0, 0.0, 0.0, 1e6, *start)]
    z = settle(sim, np.full(body[0].chambers, 1e4), load=hold)
    assert np.linalg.norm(z[-3:] + body[2].rest_tip - start) < 1e-4


def test_tilted_gravity_is_another_gravity(tripod: Body) -> None:
    robot, _, model = tripod
    tilted = np.array([3.0, 1.0, -9.0])
    turned = RomSimulator(dataclasses.replace(robot, gravity_m_s2=tuple(tilted)), model, 1.0, 1.0, 1.0)
    time, pressure = program(robot)
    by_hook = simulator(tripod).simulate(time, pressure, None, (), [hook(tilt_kernel, *tilted)])
    np.testing.assert_allclose(by_hook.position, turned.simulate(time, pressure).position, atol=1e-8)


def test_tilted_gravity_turns_the_tip_as_another_gravity(tripod: Body) -> None:
    robot, _, model = tripod
    tilted, spin = np.array([3.0, 1.0, -9.0]), np.zeros((9, 1))
    spin[[0, 4, 5], 0] = 0.01, 0.02, -0.01  # rad s^2/m
    body = RomSimulator(robot, dataclasses.replace(model, give_rotation=spin), 1.0, 1.0, 1.0)
    turned = dataclasses.replace(body, robot=dataclasses.replace(robot, gravity_m_s2=tuple(tilted)))
    time, pressure = program(robot, 20)
    by_hook, meant = body.simulate(time, pressure, None, (), [hook(tilt_kernel, *tilted)]), turned.simulate(time, pressure)
    np.testing.assert_allclose(by_hook.quaternion, meant.quaternion, atol=1e-7)
    assert np.abs(meant.quaternion - body.simulate(time, pressure).quaternion).max() > 1e-2
    state = body.step(body.reset(), pressure, DT_S, load=[hook(tilt_kernel, *tilted)])
    after = turned.step(body.reset(), pressure, DT_S)
    np.testing.assert_allclose(body.observe(state)[1], turned.observe(after)[1], atol=1e-7)


def test_leaving_the_samples_is_reported(tripod: Body, caplog: pytest.LogCaptureFixture) -> None:
    robot, _, model = tripod
    reach._reported.clear()
    time, pressure = DT_S * np.arange(1, 101), np.tile([10.0 * robot.pressure_max_pa, 0.0, 0.0], (100, 1))
    with caplog.at_level(logging.WARNING):
        motion = simulator(tripod).simulate(time, pressure)
        simulator(tripod).simulate(time, pressure)
        state = simulator(tripod).reset()
        for row in pressure:
            state = simulator(tripod).step(state, row, DT_S)
    assert np.isfinite(motion.position).all()
    # told once, and again only for going much farther
    assert 1 <= len(caplog.records) <= 6 and "times the reach of its snapshots" in caplog.text


def test_leaving_the_samples_is_reported_of_each_model_and_of_its_equilibria(
    tripod: Body, caplog: pytest.LogCaptureFixture
) -> None:
    robot, _, model = tripod
    reach._reported.clear()
    other = dataclasses.replace(model, energy=1.01 * model.energy)
    far = np.array([8.0 * robot.pressure_max_pa, 0.0, 0.0])
    held = np.tile(far, (50, 1))

    def told(work: Callable[[], object]) -> int:
        caplog.clear()
        work()
        return len(caplog.records)

    for body in (RomSimulator(robot, model, 1.0, 1.0, 1.0), RomSimulator(robot, other, 1.0, 1.0, 1.0)):
        assert told(lambda body=body: body.simulate(DT_S * np.arange(1, 51), held)) > 0
        assert told(lambda body=body: body.simulate(DT_S * np.arange(1, 51), held)) == 0
        assert told(lambda body=body: body.equilibrium(0.8 * far)) > 0, "equilibria, after a motion that went farther"
        assert "equilibria" in caplog.text
    again = RomSimulator(robot, dataclasses.replace(model, energy=model.energy.copy()), 1.0, 1.0, 1.0)
    assert told(lambda: again.equilibrium(0.8 * far)) == 0, "the same model, loaded once more"
    assert told(lambda: reach.warn_beyond(again.reduced_model, 2.0, "equilibria")) == 1, "much farther"
