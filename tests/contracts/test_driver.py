"""One contract for every driver: limits before sending, a clock that only goes on, and venting whatever happens."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.core.config import build
from softrl.core.driver import Driver, Sample
from softrl.core.errors import ConfigError, DriverError
from softrl.effects.lag import Lag
from softrl.pcc.simulator import PccSimulator
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.ports import SerialDriver, UdpDriver
from softrl.sim2real.drivers.regulator import WiredRig
from softrl.sim2real.drivers.rig import Noise
from softrl.sim2real.drivers.stub import StubDriver

PERIOD_S = 0.01
CONF = Path(__file__).parents[2] / "conf"


@pytest.fixture(scope="module")
def tripod() -> Robot:
    """Return the default robot."""
    return build(yaml.safe_load((CONF / "robot" / "tripod.yaml").read_text()), Robot, "robot")


def body_of(robot: Robot) -> PccSimulator:
    """Return the lumped body."""
    return PccSimulator(
        robot=robot, bend_at_full_pressure_rad=0.6, elongation_at_full_pressure=0.1, bending_stiffness_scale=1.0,
        axial_stiffness_scale=1.0, damping_s=0.05, mass_scale=1.0,
    )  # fmt: skip


NOISE = Noise(
    position_white_mm=0.05, position_coloured_mm=0.05, colour_s=1.0, orientation_white_deg=0.02,
    pressure_white_kpa=0.02, force_white_n=0.0, dropped_share=0.02,
)  # fmt: skip
HIDDEN = {"lag": Lag(fill_s=0.1, vent_s=0.2)}


def stub(robot: Robot, **times_s: float) -> StubDriver:
    """Return a stub on the lumped body, 100 samples a second of which some are lost."""
    usual = {"watchdog_s": 1.0, "vent_s": 0.2, "start_timeout_s": 120.0, "answer_timeout_s": 20.0}
    return StubDriver(
        robot=robot, body=body_of(robot), hidden=HIDDEN, noise=NOISE, rate_hz=1.0 / PERIOD_S, physics_rate_hz=400.0, seed=3,
        **usual | times_s,
    )  # fmt: skip


def rig(robot: Robot) -> WiredRig:
    """Return such a rig behind a real transport; its own watchdog is tested elsewhere."""
    return WiredRig(
        robot=robot, body=body_of(robot), hidden=HIDDEN, noise=NOISE, rate_hz=1.0 / PERIOD_S, physics_rate_hz=100.0,
        watchdog_s=0.1, speed=1.0, start_timeout_s=120.0, seed=3,
    )  # fmt: skip


WIRE = {"watchdog_s": 1.0, "link_timeout_s": 10.0, "vent_s": 0.2, "start_timeout_s": 120.0}
DRIVERS: dict[str, Callable[[Robot], Driver]] = {
    "stub": stub,
    "serial": lambda robot: SerialDriver(robot=robot, port=None, baud=460800, rig=rig(robot), **WIRE),
    "udp": lambda robot: UdpDriver(robot=robot, host=None, port=None, rig=rig(robot), **WIRE),
}


@pytest.fixture(params=DRIVERS, scope="module")
def driver(request: pytest.FixtureRequest, tripod: Robot) -> Driver:
    """Return each driver in turn; every test enters it anew, whatever the test before did to it."""
    return DRIVERS[request.param](tripod)


def run_wildly(driver: Driver, robot: Robot, steps: int = 120) -> list[Sample]:
    """Ask for pressures far outside the limits, at random, and return what arrived."""
    rng = np.random.default_rng(0)
    samples: list[Sample] = []
    for _ in range(steps):
        driver.command(rng.uniform(-3.0, 3.0, robot.chambers) * robot.pressure_max_pa)
        samples += driver.advance(rng.choice([0.003, 0.01, 0.05]))
    return samples


def test_limits_hold_for_everything_that_is_sent(driver: Driver, tripod: Robot) -> None:
    with driver:
        samples = run_wildly(driver, tripod)
    sent = np.stack([s.commanded for s in samples])
    time = np.array([s.time_s for s in samples])
    assert sent.max() <= tripod.pressure_max_pa
    assert sent.min() >= tripod.pressure_min_pa
    rate = np.abs(np.diff(sent, axis=0)) / np.diff(time)[:, None]
    assert rate.max() <= tripod.slew_pa_per_s * (1 + 1e-6), f"slew {rate.max():g} Pa/s"
    # the law is not satisfied by never moving: the limits were reached
    assert np.ptp(sent) > 0.9 * (tripod.pressure_max_pa - tripod.pressure_min_pa)


def test_a_step_larger_than_one_period_of_slew_arrives_in_the_end(driver: Driver, tripod: Robot) -> None:
    goal = np.array([30e3, -10e3, 99e3])
    with driver:
        first = driver.command(goal)
        samples = driver.advance(0.5)
    np.testing.assert_allclose(np.abs(first).max(), tripod.slew_pa_per_s * PERIOD_S)
    np.testing.assert_array_equal(samples[-1].commanded, [30e3, -10e3, tripod.pressure_max_pa])


def test_the_device_clock_increases_and_keeps_the_time_asked_for(driver: Driver, tripod: Robot) -> None:
    with driver:
        samples = [s for _ in range(37) for s in driver.advance(0.0271)]
    time = np.array([s.time_s for s in samples])
    assert (np.diff(time) > 0).all()
    assert time[-1] > 37 * 0.0271 - 3 * PERIOD_S
    if isinstance(driver, StubDriver):  # in real time the caller's own time counts as well
        assert time[-1] < 37 * 0.0271 + 3 * PERIOD_S
    assert all(np.isfinite(s.position).all() for s in samples)
    np.testing.assert_allclose([np.linalg.norm(s.quaternion) for s in samples], 1.0, atol=1e-12)


@pytest.mark.parametrize("bad", [np.array([1e3, np.nan, 0.0]), np.array([1e3, 0.0]), np.array([[1e3, 0.0, 0.0]])])
def test_a_malformed_command_is_refused_and_the_robot_vented(driver: Driver, bad: np.ndarray) -> None:
    with pytest.raises(DriverError, match="expected"), driver:
        driver.command(np.full(3, 20e3))
        driver.advance(0.2)
        driver.command(bad)
    assert not driver.samples[-1].commanded.any()


@pytest.mark.parametrize("error", [None, ValueError, KeyboardInterrupt])
def test_it_vents_on_exit_and_on_any_exception(driver: Driver, error: type[BaseException] | None) -> None:
    def use() -> None:
        with driver:
            driver.command(np.full(3, 20e3))
            driver.advance(0.5)
            if error is not None:
                raise error("from the caller")

    if error is None:
        use()
    else:
        with pytest.raises(error, match="from the caller"):
            use()
    before = next(s for s in reversed(driver.samples) if s.commanded.any())
    after = driver.samples[-1]
    assert after.time_s > before.time_s
    assert not after.commanded.any()
    assert after.pressure.max() < 0.6 * before.pressure.max()


def test_the_watchdog_vents_a_robot_that_nobody_commands(driver: Driver) -> None:
    with pytest.raises(DriverError, match="watchdog"), driver:
        driver.command(np.full(3, 20e3))
        driver.advance(3.0)
    filled = next(s.time_s for s in driver.samples if s.commanded.any())
    vented = next(s.time_s for s in driver.samples if s.time_s > filled + 0.5 and not s.commanded.any())
    assert 0.9 < vented - filled < 1.3


def test_a_fault_lasts_for_its_session_though_the_caller_swallows_it(driver: Driver) -> None:
    with pytest.raises(DriverError, match="watchdog"), driver:
        driver.command(np.full(3, 20e3))
        with pytest.raises(DriverError, match="watchdog"):
            driver.advance(3.0)
        driver.command(np.full(3, 20e3))
    assert not driver.samples[-1].commanded.any()


def test_an_emergency_stop_vents_and_lasts_until_it_is_released(driver: Driver) -> None:
    with pytest.raises(DriverError, match="emergency stop"), driver:
        driver.command(np.full(3, 20e3))
        driver.advance(0.2)
        driver.stop()
        driver.advance(0.2)
    assert not driver.samples[-1].commanded.any()
    with pytest.raises(DriverError, match="emergency stop"), driver:
        pass
    driver.release()
    with driver:
        driver.command(np.full(3, 20e3))
        assert driver.advance(0.3)[-1].commanded.any()


def test_a_stop_between_sessions_lasts_as_well(driver: Driver) -> None:
    driver.stop()
    with pytest.raises(DriverError, match="emergency stop"), driver:
        pass
    driver.release()
    with driver:
        assert driver.advance(0.3)


def test_a_vented_robot_may_wait(driver: Driver) -> None:
    with driver:
        assert driver.advance(3.0)


def test_use_outside_a_with_block_is_refused(driver: Driver) -> None:
    with pytest.raises(DriverError, match="not connected"):
        driver.command(np.zeros(3))
    with pytest.raises(DriverError, match="not connected"):
        driver.advance(0.1)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("name", ["watchdog_s", "vent_s", "start_timeout_s", "link_timeout_s"])
def test_times_that_would_watch_nothing_are_refused(tripod: Robot, name: str, bad: float) -> None:
    with pytest.raises(ConfigError, match=rf"driver\.{name}={bad:g} must be positive"):
        SerialDriver(robot=tripod, port="/dev/nothing", baud=460800, **WIRE | {name: bad})
    if name == "link_timeout_s":
        return
    with pytest.raises(ConfigError, match=rf"driver\.{name}={bad:g} must be positive"):
        stub(tripod, **{name: bad})


def test_another_number_of_chambers_works(tripod: Robot) -> None:
    finger = replace(tripod, name="finger", chamber_angle_deg=(-90.0,))
    with stub(finger) as driver:
        driver.command(np.array([20e3]))
        samples = driver.advance(0.3)
    assert samples[-1].commanded.shape == samples[-1].pressure.shape == (1,)
