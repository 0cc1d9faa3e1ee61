"""A batch of plants is the plants one by one."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.core.simulator import Hook
from softrl.effects.call import pack, unpack
from softrl.effects.chain import Plant, chain_of, simulate_batch
from softrl.effects.delay import Delay
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.effects.leak import Leak
from softrl.effects.payload import Payload
from softrl.effects.replay import replay, replay_batch
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"
TIME = 0.01 * np.arange(1, 301)
PRESSURE = 2e4 * np.sin(np.outer(TIME, [2.0, 1.3, 0.7]))


@cache
def body() -> PccSimulator:
    data = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text())
    data.pop("_target_")
    return PccSimulator(Robot(**yaml.safe_load((CONF / "robot" / "tripod.yaml").read_text())), **data)


def plants() -> list[Plant]:
    """Return plants that share a valve, differ in it, differ in the body, and differ in everything."""
    chain = chain_of(body().robot, [Lag(0.1, 0.2), Leak(0.2, 3.0), Hysteresis(0.1, 0.02), Payload(0.2), Delay(0.05)])
    slower = replace(chain, effects=(Lag(0.3, 0.2), *chain.effects[1:]))
    rougher = replace(chain, effects=(*chain.effects[:2], Hysteresis(0.2, 0.02), *chain.effects[3:]))
    heavy = body().with_parameters(mass_scale=2.0)
    return [Plant(b, c) for b in (body(), heavy) for c in (chain, slower, rougher, chain_of(body().robot, []))]


@pytest.mark.parametrize("workers", [1, 2])
def test_batch_is_one_by_one_to_the_last_bit(workers: int) -> None:
    together = simulate_batch(plants(), TIME, PRESSURE, workers=workers)
    for plant, motion in zip(plants(), together, strict=True):
        alone = plant.simulate(TIME, PRESSURE)
        for channel in ("time", "position", "quaternion", "pressure"):
            np.testing.assert_array_equal(getattr(motion, channel), getattr(alone, channel))
    assert len({motion.position.tobytes() for motion in together}) == len(together)


@pytest.mark.parametrize("drive", ["command", "measured"])
def test_replaying_a_batch_is_replaying_each(drive: str) -> None:
    late = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.03, 200))
    wave = 2e4 * np.sin(np.outer(late, [1.0, 2.0, 3.0]))
    recording = Recording("a", "s", late, wave, pressure_meas=0.9 * wave)
    together = replay_batch(plants(), recording, 0.01, drive, settle_s=0.5)
    for plant, made in zip(plants(), together, strict=True):
        alone = replay(plant, recording, 0.01, drive, settle_s=0.5)
        np.testing.assert_array_equal(made.position, alone.position)
        np.testing.assert_array_equal(made.pressure_meas, alone.pressure_meas)


def test_packed_states_come_back() -> None:
    chain = chain_of(body().robot, [Hysteresis(0.1, 0.02), Leak(0.2, 3.0)])
    hooks = [Hook(type(e).kernel, e.pack(chain.robot), np.full(3, float(k))) for k, e in enumerate(chain.ordered)]
    calls = pack(hooks)
    calls.states[:] += 10.0
    assert [hook.state[0] for hook in hooks] == [0.0, 1.0]
    unpack(calls, hooks)
    assert [hook.state[0] for hook in hooks] == [10.0, 11.0]
    assert len(pack(()).kernels) == 0
