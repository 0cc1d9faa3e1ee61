"""Laws of the rig's physics and sensors, tried in the same process."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.effects.chain import Plant, chain_of
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.mount_tilt import MountTilt
from softrl.effects.payload import Payload
from softrl.effects.stiffness_scale import StiffnessScale
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.robots.robot import Robot
from softrl.sim2real.drivers.rig import Hardware, Noise, Rig, Sensors, sample_of, turned

LEVEL = np.array([20e3, 5e3, -5e3])


def hardware(body: Simulator, robot: Robot, noise: Noise, *effects: Effect, rate_hz: float = 100.0) -> Hardware:
    return Hardware(body, chain_of(robot, effects), noise, rate_hz, 400.0, watchdog_s=10.0)


SEED = (1, 2)


def positions(rig: Rig, ticks: int = 150) -> np.ndarray:
    rows, fault = rig.advance(ticks, LEVEL[None])
    assert fault is None
    return np.stack([sample_of(row).position for row in rows])


def test_without_noise_and_effects_it_is_the_simulator(body: Simulator, tripod: Robot, silence: Noise) -> None:
    alone = replace(hardware(body, tripod, silence), physics_rate_hz=100.0)
    motion = body.simulate(0.01 * np.arange(1, 151), np.tile(LEVEL, (150, 1)))
    np.testing.assert_allclose(positions(Rig(alone, SEED)), motion.position, atol=1e-9)


def test_with_effects_it_is_the_plant_at_its_own_rate(body: Simulator, tripod: Robot, silence: Noise) -> None:
    lag = Lag(fill_s=0.2, vent_s=0.4)
    fine = Plant(body, chain_of(tripod, [lag])).simulate(0.0025 * np.arange(1, 601), np.tile(LEVEL, (600, 1)))
    rig = Rig(hardware(body, tripod, silence, lag), SEED)
    np.testing.assert_allclose(positions(rig), fine.position[3::4], atol=1e-9)


@pytest.mark.parametrize(
    "effects",
    [(Payload(0.3), StiffnessScale(2.0)), (MountTilt(0.3, 0.0), Viscoelasticity(1.0, 2.0, 0.0, 20.0)),
     (Payload(0.3, since_s=0.5, over_s=0.1),)],
    ids=["stiffer", "creeping", "later"],
)  # fmt: skip
def test_a_loaded_rig_begins_where_its_plant_does(
    body: Simulator, tripod: Robot, silence: Noise, effects: tuple[Effect, ...]
) -> None:
    alone = replace(hardware(body, tripod, silence, *effects), physics_rate_hz=100.0)
    motion = Plant(body, chain_of(tripod, effects)).simulate(0.01 * np.arange(1, 151), np.tile(LEVEL, (150, 1)))
    np.testing.assert_allclose(positions(Rig(alone, SEED)), motion.position, atol=2e-8)


def test_hidden_effects_change_the_motion(body: Simulator, tripod: Robot, silence: Noise) -> None:
    plain = positions(Rig(hardware(body, tripod, silence), SEED))
    lagged = positions(Rig(hardware(body, tripod, silence, Lag(fill_s=0.2, vent_s=0.4)), SEED))
    assert np.abs(plain - lagged).max() > 1e-3


def test_the_same_seed_gives_the_same_samples(body: Simulator, tripod: Robot, silence: Noise) -> None:
    noisy = replace(silence, position_white_mm=0.1, position_coloured_mm=0.1, dropped_share=0.1)
    same = hardware(body, tripod, noisy)
    np.testing.assert_array_equal(positions(Rig(same, SEED)), positions(Rig(same, SEED)))
    other = positions(Rig(same, (1, 3)))
    assert len(other) != len(positions(Rig(same, SEED))) or not np.array_equal(other, positions(Rig(same, SEED)))


def test_the_watchdog_counts_only_under_pressure(body: Simulator, tripod: Robot, silence: Noise) -> None:
    quick = replace(hardware(body, tripod, silence), watchdog_s=0.2)
    assert Rig(quick, SEED).advance(100, np.zeros((0, 3)))[1] is None
    rows, fault = Rig(quick, SEED).advance(100, LEVEL[None])
    assert fault is not None and "watchdog" in fault
    under_pressure = [row[0] for row in rows if sample_of(row).commanded.any()]
    assert under_pressure[-1] == pytest.approx(0.2, abs=0.021)


def read(noise: Noise, count: int, quaternion: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> list[Any]:
    """Return what sensors make of a robot at rest at the origin."""
    sensors = Sensors(noise, 3, 0.01, np.random.default_rng(0))
    return [sensors.read(np.zeros(3), np.zeros(3), np.array(quaternion), np.zeros(3)) for _ in range(count)]


def test_noise_has_the_size_and_colour_it_is_given(silence: Noise) -> None:
    noise = replace(silence, position_white_mm=0.05, position_coloured_mm=0.2, colour_s=0.5, pressure_white_kpa=0.03)
    sensed = read(noise, 40000)
    error_mm = 1e3 * np.stack([position for _, position, *_ in sensed])
    assert error_mm.std() == pytest.approx(np.hypot(0.05, 0.2), rel=0.03)
    lagged = float(np.mean(error_mm[50:] * error_mm[:-50]))
    assert lagged == pytest.approx(0.2**2 * np.exp(-1.0), rel=0.15), "correlation after one colour_s"
    assert np.stack([pressure for pressure, *_ in sensed]).std() == pytest.approx(30.0, rel=0.02)


def test_the_share_of_samples_that_drop_is_the_one_given(silence: Noise) -> None:
    lost = np.mean([sensed is None for sensed in read(replace(silence, dropped_share=0.1), 20000)])
    assert lost == pytest.approx(0.1, abs=0.01)


def test_orientation_noise_turns_by_its_own_size(silence: Noise) -> None:
    start = (0.8, 0.0, 0.6, 0.0)
    quaternion = np.stack([q for _, _, q, _ in read(replace(silence, orientation_white_deg=0.5), 5000, start)])
    angle = 2.0 * np.arccos(np.clip(quaternion @ np.array(start), -1.0, 1.0))
    assert np.rad2deg(np.sqrt(np.mean(angle**2) / 3.0)) == pytest.approx(0.5, rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0)


def test_a_turn_about_z_turns_x_towards_y() -> None:
    quaternion = turned(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1e-3]))
    np.testing.assert_allclose(quaternion, [1.0, 0.0, 0.0, 5e-4], atol=1e-6)


def test_impossible_noise_is_refused(silence: Noise) -> None:
    with pytest.raises(ConfigError, match=r"dropped_share=1"):
        replace(silence, dropped_share=1.0)
    with pytest.raises(ConfigError, match="colour_s=0"):
        replace(silence, colour_s=0.0)
