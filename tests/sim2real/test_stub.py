"""The link between the driver and its rig: what happens when it breaks, and what crosses it."""

import os
import pickle
import signal
import time

import numpy as np
import pytest

from softrl.core.driver import Stream
from softrl.core.errors import ConfigError, DriverError
from softrl.core.simulator import Simulator
from softrl.effects.lag import Lag
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.rig import Noise
from softrl.sim2real.drivers.stub import StubDriver

HIDDEN = Lag(fill_s=0.123, vent_s=0.456)


def stub(robot: Robot, body: Simulator, noise: Noise, answer_timeout_s: float = 20.0, seed: int = 1) -> StubDriver:
    return StubDriver(
        robot=robot, body=body, hidden={"lag": HIDDEN}, noise=noise, rate_hz=100.0, physics_rate_hz=200.0,
        watchdog_s=1.0, vent_s=0.1, start_timeout_s=120.0, answer_timeout_s=answer_timeout_s, seed=seed,
    )  # fmt: skip


@pytest.fixture(scope="module")
def noisy(silence: Noise) -> Noise:
    """Return sensors with white noise."""
    return Noise(**{**vars(silence), "position_white_mm": 0.1})


@pytest.fixture(scope="module")
def driver(tripod: Robot, body: Simulator, noisy: Noise) -> StubDriver:
    """Return a stub that tests enter one after the other."""
    return stub(tripod, body, noisy)


def test_a_killed_rig_is_reported_and_its_samples_are_kept(driver: StubDriver) -> None:
    with pytest.raises(DriverError, match="lost the link to the rig: its process was killed by signal 9"), driver:
        driver.command(np.full(3, 10e3))
        driver.advance(0.5)
        os.kill(driver.rig_pid, signal.SIGKILL)
        driver.advance(0.5)
    assert len(driver.samples) == 50
    with driver:
        assert len(driver.advance(0.1)) == 10, "it can be entered again"


def test_a_rig_that_hangs_counts_as_lost(tripod: Robot, body: Simulator, noisy: Noise) -> None:
    driver = stub(tripod, body, noisy, answer_timeout_s=2.0)
    with pytest.raises(DriverError, match=r"did not answer within 2 s"), driver:
        driver.advance(0.1)
        os.kill(driver.rig_pid, signal.SIGSTOP)
        driver.advance(0.1)
    assert len(driver.samples) == 10


def test_a_rig_ends_with_its_driver_and_survives_an_interrupt(tripod: Robot, body: Simulator, noisy: Noise) -> None:
    driver = stub(tripod, body, noisy)
    with driver:
        rig = driver.rig_pid
        assert rig is not None
        os.kill(rig, signal.SIGINT)
        time.sleep(0.1)
        assert driver.advance(0.1)
    with driver:
        assert driver.rig_pid == rig, "the process serves the next entry too"
    del driver
    os.waitpid(rig, 0)


def test_each_entry_has_noise_of_its_own_and_a_new_driver_repeats_it(
    tripod: Robot, body: Simulator, noisy: Noise
) -> None:
    def positions(driver: StubDriver) -> np.ndarray:
        with driver:
            return np.stack([s.position for s in driver.advance(0.3)])

    driver = stub(tripod, body, noisy)
    first, second = positions(driver), positions(driver)
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(positions(stub(tripod, body, noisy)), first)


def test_nothing_of_the_hidden_physics_crosses_the_link(driver: StubDriver) -> None:
    with driver:
        driver.command(np.full(3, 10e3))
        samples = pickle.dumps(driver.advance(0.3)).lower()
    assert b"lag" not in samples.replace(b"flag", b"")
    for value in (HIDDEN.fill_s, HIDDEN.vent_s):
        assert np.float64(value).tobytes() not in samples


def test_rates_that_do_not_fit_are_refused(tripod: Robot, body: Simulator, noisy: Noise) -> None:
    with pytest.raises(ConfigError, match="physics_rate_hz=250 is no multiple"):
        StubDriver(
            robot=tripod, body=body, hidden={}, noise=noisy, rate_hz=100.0, physics_rate_hz=250.0, watchdog_s=1.0,
            vent_s=0.1, start_timeout_s=60.0, answer_timeout_s=5.0, seed=0,
        )  # fmt: skip


def test_each_stage_meets_a_noise_of_its_own(tripod: Robot, body: Simulator, noisy: Noise) -> None:
    driver, heard = stub(tripod, body, noisy), []
    for stream in (0, 0, 7):
        driver._entries, driver._stream = 0, Stream(stream)
        with driver:
            heard.append(np.stack([sample.position for sample in driver.advance(0.1)]))
    np.testing.assert_array_equal(heard[0], heard[1])
    assert np.abs(heard[0] - heard[2]).min() > 0.0
