"""One law of physics for every effect."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from softrl.core.errors import ConfigError
from softrl.core.simulator import Motion
from softrl.core.span import held
from softrl.effects import friction
from softrl.effects.area_growth import AreaGrowth
from softrl.effects.asymmetry import Asymmetry
from softrl.effects.base_tilt import BaseTilt
from softrl.effects.bend_rub import BendRub
from softrl.effects.bend_slip import BendSlip
from softrl.effects.bimodular import Bimodular
from softrl.effects.chain import EffectChain, Plant, SignalFilter, chain_of
from softrl.effects.command_map import CommandMap
from softrl.effects.contact import Contact
from softrl.effects.crosstalk import Crosstalk
from softrl.effects.dead_time import DeadTime
from softrl.effects.deadband import Deadband
from softrl.effects.delay import Delay
from softrl.effects.drift import Drift
from softrl.effects.effect import Effect
from softrl.effects.failure import Failure
from softrl.effects.flow_limit import FlowLimit
from softrl.effects.frame import Frame
from softrl.effects.friction import Friction
from softrl.effects.gain import Gain
from softrl.effects.gauge_lag import GaugeLag
from softrl.effects.hold import Hold, reading_period
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.knee import Knee
from softrl.effects.lag import Lag
from softrl.effects.leak import Leak
from softrl.effects.locking import Locking
from softrl.effects.marker_offset import MarkerOffset
from softrl.effects.mount_tilt import MountTilt
from softrl.effects.mullins import Mullins
from softrl.effects.offset import Offset
from softrl.effects.orifice import ATMOSPHERE_PA, CRITICAL, Orifice
from softrl.effects.payload import Payload
from softrl.effects.pi_regulator import PiRegulator
from softrl.effects.play import Play
from softrl.effects.port import (
    ADDED,
    ADDED_SLOPE,
    COUPLED,
    ELASTIC,
    ELASTIC_SLOPE,
    FORCE,
    FORCE_SLOPE,
    GRAVITY,
    LOAD_PORT_ROWS,
    PRESSURE,
    RATE,
    REST,
    STRAIN,
    TIP,
    TIP_VELOCITY,
    body_port,
    slope_of,
)
from softrl.effects.power_creep import PowerCreep
from softrl.effects.pressure_play import PressurePlay
from softrl.effects.pressure_sensor import PressureSensor
from softrl.effects.rate_limit import RateLimit
from softrl.effects.replay import bend_angle
from softrl.effects.shared_flow import SharedFlow
from softrl.effects.stiffness_scale import StiffnessScale
from softrl.effects.strain_softening import StrainSoftening
from softrl.effects.strain_stiffening import StrainStiffening
from softrl.effects.stretch_area import StretchArea
from softrl.effects.supply_limit import SupplyLimit
from softrl.effects.tether import Tether
from softrl.effects.thermal_softening import ThermalSoftening
from softrl.effects.tube_line import TubeLine
from softrl.effects.viscoelasticity import Viscoelasticity
from softrl.pcc.simulator import PccSimulator
from softrl.robots.robot import Robot

CONF = Path(__file__).parents[2] / "conf"
DT = 0.01
STIFFNESS = 2e5  # Pa per strain of the body that the port tests imitate


@cache
def simulator(**changed: float) -> PccSimulator:
    data = yaml.safe_load((CONF / "simulator" / "pcc.yaml").read_text()) | changed
    data.pop("_target_")
    return PccSimulator(Robot(**yaml.safe_load((CONF / "robot" / "tripod.yaml").read_text())), **data)


ROBOT = simulator().robot
FULL = ROBOT.pressure_max_pa


def ends(effects: list[Effect], values: np.ndarray, dt_s: float = DT, robot: Robot = ROBOT) -> np.ndarray:
    """Return the pressures (steps, n) at the steps' ends, or poses, after effects at one site."""
    run = SignalFilter(chain_of(robot, effects), effects[0].acts_at)
    values = np.atleast_2d(values)
    return run.advance(values, dt_s) if effects[0].acts_at == "sensor" else run.lead(held(values), dt_s).end


def signal(effect: Effect, values: np.ndarray, dt_s: float = DT) -> np.ndarray:
    return ends([effect], values, dt_s)


def step_to(pressure: float, steps: int) -> np.ndarray:
    return np.full((steps, 3), pressure)


def pulls(effect: Effect, strains: np.ndarray, dt_s: float = DT, pressure: float = 0.0) -> np.ndarray:
    """Return the added pressure (steps, 3) along a path (steps, 3) of the chambers' strains, every step committed."""
    state, added, last = effect.reset(ROBOT), [], np.zeros(3)
    for value in strains:
        port = body_port(3)
        port[STRAIN], port[RATE] = value, (value - last) / dt_s
        port[ELASTIC], port[ELASTIC_SLOPE], port[REST], port[PRESSURE] = (
            STIFFNESS * value,
            STIFFNESS,
            STIFFNESS,
            pressure,
        )
        type(effect).kernel(effect.pack(ROBOT), state, port, dt_s, True)
        added.append(port[ADDED].copy())
        last = value
    return np.array(added)


def pull(effect: Effect, strain: np.ndarray, dt_s: float = DT, pressure: float = 0.0) -> np.ndarray:
    """Return the added pressure (steps,) in chamber 0 where all chambers are strained alike along a path (steps,)."""
    return pulls(effect, np.repeat(strain[:, None], 3, axis=1), dt_s, pressure)[:, 0]


def move(effects: list[Effect], pressure: np.ndarray, body: PccSimulator | None = None, **kwargs: np.ndarray) -> Motion:
    time = DT * np.arange(1, len(pressure) + 1)
    return Plant(body or simulator(), chain_of(ROBOT, effects)).simulate(time, pressure, **kwargs)


def test_lag_reaches_63_percent_after_its_time_constant() -> None:
    supplied = signal(Lag(fill_s=0.3, vent_s=0.8), np.vstack([step_to(1e4, 1000), step_to(0.0, 1000)]))[:, 0]
    np.testing.assert_allclose(supplied[29], 1e4 * (1 - np.exp(-1)), rtol=1e-9)
    np.testing.assert_allclose(supplied[1079], supplied[999] * np.exp(-1), rtol=1e-9)


def test_dead_time_shifts_exactly() -> None:
    command = np.random.default_rng(1).normal(0.0, 1e4, (300, 3))
    np.testing.assert_allclose(signal(DeadTime(delay_s=0.07), command)[7:], command[:-7], rtol=1e-12)
    assert not signal(DeadTime(delay_s=0.07), command)[:7].any()
    half = signal(DeadTime(delay_s=0.075), command)[8:]
    np.testing.assert_allclose(half, 0.5 * (command[:-8] + command[1:-7]), rtol=1e-9, atol=1e-6)


def test_a_dispersed_dead_time_is_second_order_after_its_delay_and_as_late_on_average() -> None:
    supplied = signal(DeadTime(delay_s=0.4, dispersion=0.03125), step_to(1e4, 4000), DT / 10)[:, 0] / 1e4
    assert not supplied[:300].any()
    since = DT / 10 * np.arange(1, 3701) / 0.05  # in time constants of each lag
    np.testing.assert_allclose(supplied[300:], 1.0 - (1.0 + since) * np.exp(-since), atol=0.01)
    arrival = DT / 10 * np.arange(4000)
    weight = np.diff(supplied, prepend=0.0)
    np.testing.assert_allclose(weight @ arrival, 0.4, atol=2e-3)
    np.testing.assert_allclose(weight @ (arrival - weight @ arrival) ** 2, 0.03125 * 0.4**2, rtol=0.03)


@pytest.mark.parametrize("dispersion", [0.0, 0.002, 0.03, 0.125])
@pytest.mark.parametrize("dt_s", [0.02, 0.01, 0.001])
def test_what_disperses_arrives_no_later_on_average_whatever_the_step(dispersion: float, dt_s: float) -> None:
    """Else a fit in long steps would rather do without dispersion."""
    supplied = signal(DeadTime(delay_s=0.06, dispersion=dispersion), step_to(1e4, round(2.0 / dt_s)), dt_s)[:, 0] / 1e4
    assert dt_s * np.sum(1.0 - supplied) == pytest.approx(0.06, abs=1e-9)


def test_deadband_is_a_play_whose_width_is_free_of_rate() -> None:
    band = 0.05
    for steps in (100, 1000):
        wave = np.concatenate([np.linspace(0, 2e4, steps), np.linspace(2e4, 0, steps)])
        supplied = signal(Deadband(band=band), np.tile(wave[:, None], 3))[:, 0]
        up, down = (
            np.interp(1e4, wave[:steps], supplied[:steps]),
            np.interp(-1e4, -wave[steps:], supplied[steps:]),
        )
        np.testing.assert_allclose(down - up, 2 * band * FULL, rtol=1e-6)


@pytest.mark.parametrize("closes_at", [0.0, 0.4])
def test_deadband_whose_valves_close_within_it_climbs_by_steps(closes_at: float) -> None:
    band, steps = 0.05, 5000
    ramp = np.tile(np.linspace(0.0, FULL, steps)[:, None], 3)
    supplied = signal(Deadband(band=band, closes_at=closes_at), ramp)[:, 0]
    climbed = np.diff(supplied)
    climbed = climbed[climbed > 0.0]
    np.testing.assert_allclose(climbed, (1.0 - closes_at) * band * FULL, atol=2.0 * FULL / steps)
    assert len(climbed) == pytest.approx((1.0 - band) / ((1.0 - closes_at) * band), abs=1.0)
    assert np.abs(supplied - ramp[:, 0]).max() <= band * FULL


def test_deadband_fills_at_the_rate_of_its_valves_and_then_rests_within_the_band() -> None:
    rate, band = 2.0, 0.05
    supplied = signal(Deadband(band=band, closes_at=0.4, fill_per_s=rate), step_to(FULL, 100))[:, 0]
    rising = np.diff(supplied, prepend=0.0)
    climbs = int((1.0 - 0.4 * band) / (rate * DT))
    np.testing.assert_allclose(rising[:climbs], rate * FULL * DT)
    np.testing.assert_allclose(supplied[climbs + 1 :], (1.0 - 0.4 * band) * FULL)


def test_rate_limit_ramps_at_its_rates() -> None:
    supplied = signal(RateLimit(rise_per_s=0.5, fall_per_s=0.25), np.vstack([step_to(FULL, 100), step_to(0.0, 100)]))[
        :, 0
    ]
    np.testing.assert_allclose(np.diff(supplied[:100]), 0.5 * FULL * DT)
    np.testing.assert_allclose(np.diff(supplied[100:]), -0.25 * FULL * DT)


@pytest.mark.parametrize("effect", [RateLimit(0.5, 0.25, lag_s=0.2), FlowLimit(0.5, 0.0, lag_s=0.2)], ids=["rate", "flow"])
def test_a_regulator_meets_its_command_with_its_lag(effect: Effect) -> None:
    """At the full rate until what is left would take one time constant, exponentially from there on; a lag without bounds."""
    supplied = signal(effect, step_to(FULL, 400))[:, 0]
    linear = int((1.0 - 0.5 * 0.2) / (0.5 * DT))
    np.testing.assert_allclose(np.diff(supplied[:linear]), 0.5 * FULL * DT)
    left = FULL - supplied[linear + 1 : linear + 100]
    np.testing.assert_allclose(left, left[0] * np.exp(-DT * np.arange(len(left)) / 0.2), rtol=1e-9)
    free = type(effect).neutral()
    commands = np.vstack([step_to(FULL, 50), step_to(0.2 * FULL, 50)])
    lag = signal(Lag(fill_s=0.2, vent_s=0.2), commands)
    np.testing.assert_allclose(signal(replace(free, lag_s=0.2), commands), lag, rtol=1e-12)


@pytest.mark.parametrize("rate", [1e4, 1.5], ids=["free", "bounded"])
@pytest.mark.parametrize(("lag_s", "integral_s"), [(0.1, 0.15), (0.1, 0.4), (0.1, 1.0)], ids=["rings", "critical", "creeps"])
def test_pi_regulator_follows_its_law(lag_s: float, integral_s: float, rate: float) -> None:
    """Against the law itself, integrated: steps up and down, with the integral that goes on while the flow is bounded."""
    commands = np.vstack([step_to(FULL, 150), step_to(0.3 * FULL, 150)])
    deep = replace(ROBOT, pressure_min_pa=-FULL)  # nothing here swings below its lowest pressure, which is a law of its own
    regulator = PiRegulator(lag_s=lag_s, integral_s=integral_s, rate_per_s=rate)
    supplied = ends([regulator], commands, robot=deep)[:, 0]

    def law(_: float, x: np.ndarray, command: float) -> list[float]:
        error = command - x[0]
        return [float(np.clip((error + x[1] / integral_s) / lag_s, -rate * FULL, rate * FULL)), error]

    state, expected = np.zeros(2), []
    for command in commands[:, 0]:
        state = solve_ivp(law, (0.0, DT), state, args=(command,), rtol=1e-9, atol=1e-6, max_step=0.1 * DT).y[:, -1]
        expected.append(state[0])
    np.testing.assert_allclose(supplied, expected, atol=1e-6 * FULL if rate > 1e3 else 5e-3 * FULL)
    assert supplied.max() > 1.05 * FULL


SLOW = [
    [Lag(0.02, 0.05)], [RateLimit(2.0, 3.0)], [RateLimit(2.0, 3.0, 0.03)], [FlowLimit(2.0, 0.3)], [FlowLimit(2.0, 0.3, 0.03)],
    [Orifice(0.1, 0.2)], [TubeLine(0.2, 0.5)], [PiRegulator(0.03, 0.2)], [PiRegulator(0.03, 0.2, 2.0)], [SharedFlow(2.0)],
    [Deadband(0.02, 0.3, 3.0)], [Leak(1.0, 0.5)],
    [Lag(0.1, 0.1), FlowLimit(2.0, 0.3, 0.05)], [TubeLine(0.3, 0.4), Lag(0.05, 0.1)],
]  # fmt: skip


@pytest.mark.parametrize("effects", SLOW, ids=lambda effects: "+".join(effect.name() for effect in effects))
def test_pressures_on_their_way_act_with_their_mean_over_each_step(effects: list[Effect]) -> None:
    """As the same in steps of a hundredth tell it; with what there is at a step's end they would act half a step early."""
    levels = FULL * np.random.default_rng(5).uniform(0.0, 0.9, (12, 3))
    coarse, fine = np.repeat(levels, 25, axis=0), np.repeat(levels, 2500, axis=0)
    seen, known = (
        SignalFilter(chain_of(ROBOT, effects), effects[0].acts_at).lead(held(rows), dt)
        for rows, dt in ((coarse, DT), (fine, 0.01 * DT))
    )
    mean = known.mean.reshape(300, 100, 3).mean(axis=1)
    early = np.sqrt(np.mean((known.end[99::100] - mean) ** 2))
    assert np.sqrt(np.mean((seen.mean - mean) ** 2)) < 0.05 * early
    assert np.sqrt(np.mean((seen.end - known.end[99::100]) ** 2)) < 0.1 * early


@pytest.mark.parametrize("effects", SLOW[:-2], ids=lambda effects: effects[0].name())
def test_a_look_lets_no_time_pass(effects: list[Effect]) -> None:
    (effect,), pressure = effects, FULL * np.array([0.7, 0.2, 0.4])
    state, _ = effect.apply(ROBOT, effect.reset(ROBOT), pressure, DT)
    after, seen = effect.apply(ROBOT, state, pressure, 0.0)
    np.testing.assert_array_equal(after, state)
    np.testing.assert_allclose(seen, effect.apply(ROBOT, state, pressure, 1e-9)[1], atol=1e-5 * FULL)


def test_a_regulator_without_lag_is_the_limit_of_a_quick_one() -> None:
    commands = np.vstack([step_to(FULL, 100), step_to(0.3 * FULL, 100)])
    for rest in ({"integral_s": 0.5, "rate_per_s": 0.8}, {"integral_s": 1e4, "rate_per_s": 0.8}, {"integral_s": 0.5}):
        none, quick = (signal(PiRegulator(lag_s=lag, **rest), commands) for lag in (0.0, 1e-3))
        np.testing.assert_allclose(none, quick, atol=5e-3 * FULL)


def test_chambers_share_one_pump_s_flow() -> None:
    """Alone a chamber fills at the pump's rate, three together at a third of it each; all vent at once."""
    alone = step_to(FULL, 100) * [1.0, 0.0, 0.0]
    np.testing.assert_allclose(np.diff(signal(SharedFlow(rise_per_s=0.5), alone)[:, 0]), 0.5 * FULL * DT)
    together = signal(SharedFlow(rise_per_s=0.5), np.vstack([step_to(FULL, 100), step_to(0.0, 2)]))
    np.testing.assert_allclose(np.diff(together[:100], axis=0), 0.5 / 3.0 * FULL * DT)
    assert not together[100:].any()


def test_supply_limit_clips_both_ends() -> None:
    command = np.linspace(ROBOT.pressure_min_pa, FULL, 50)[:, None] * np.ones(3)
    supplied = signal(SupplyLimit(ceiling=0.6, floor=0.5), command)
    np.testing.assert_array_equal(supplied, np.clip(command, 0.5 * ROBOT.pressure_min_pa, 0.6 * FULL))


@pytest.mark.parametrize(
    "valve",
    [Lag(0.3, 0.5), RateLimit(0.4, 0.4), FlowLimit(0.4, 0.5), Orifice(0.5, 0.5), PiRegulator(0.1, 0.5), DeadTime(0.1)],
    ids=lambda effect: effect.name(),
)
def test_a_valve_fills_from_what_its_source_has(valve: Effect) -> None:
    """A chamber at the ceiling vents as soon as it is told to: there was nothing beyond it to vent first."""
    command = np.vstack([step_to(FULL, 400), step_to(0.0, 200)])
    limited = ends([valve, SupplyLimit(ceiling=0.6, floor=1.0)], command)
    np.testing.assert_array_equal(limited, signal(valve, np.minimum(command, 0.6 * FULL)))
    span = [Gain(gain=1.3, before_gauge=True), SupplyLimit(ceiling=0.6, floor=1.0)]
    assert ends(span, command).max() <= 0.6 * FULL


def test_tube_line_overshoots_as_a_second_order_system() -> None:
    zeta, dt = 0.4, 1e-4
    supplied = signal(TubeLine(period_s=0.6, damping_ratio=zeta), step_to(1.0, 20000), dt)[:, 0]
    np.testing.assert_allclose(dt * (supplied.argmax() + 1), 0.3 / np.sqrt(1 - zeta**2), rtol=0.01)  # half a damped period
    np.testing.assert_allclose(supplied.max() - 1.0, np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), rtol=0.01)
    np.testing.assert_allclose(supplied[-1], 1.0, rtol=1e-3)


def test_leak_decays_and_settles() -> None:
    slow = signal(Leak(leak_per_s=0.2, refill_s=1000.0), step_to(1e4, 300))[:, 0]
    np.testing.assert_allclose(slow, 1e4 * np.exp(-0.2 * DT * np.arange(1, 301)), rtol=3e-3)
    settled = signal(Leak(leak_per_s=0.2, refill_s=3.0), step_to(1e4, 6000))[-1]
    np.testing.assert_allclose(settled, 1e4 / (1 + 0.2 * 3.0), rtol=1e-9)


@pytest.mark.parametrize(
    "effect",
    [Leak(0.3, 3.0), Leak(0.3, 10.0), Leak(1.0, 10.0, 0.5), PiRegulator(0.1, 0.5), PiRegulator(0.1, 0.2, 2.0)],
    ids=["leak", "slow", "orifice", "regulator", "bounded"],
)
def test_nothing_sucks_a_vented_chamber_below_what_its_source_gives(effect: Effect) -> None:
    """Empty it stays, and fills anew as one that was never full."""
    dry = replace(ROBOT, pressure_min_pa=0.0)
    once = np.vstack([step_to(0.8 * FULL, 600), step_to(0.0, 300)])
    twice = ends([effect], np.vstack([once, once]), robot=dry)
    assert twice.min() >= 0.0
    assert not twice[880:900].any()
    np.testing.assert_allclose(twice[900:], twice[:900], atol=1e-9 * FULL)
    sucked = np.vstack([once, step_to(-0.1 * FULL, 300)])  # of what is told to go lower, that is the source
    assert ends([effect], sucked, robot=dry).min() >= -0.1 * FULL - 1e-9


def test_leak_through_an_orifice_settles_where_the_flows_balance() -> None:
    """In the long run ``leak sqrt(p p_max) = d / refill`` with ``p = supply - d``: a quadratic in the root of p."""
    leak, refill, supply = 0.1, 3.0, 0.6
    root = 0.5 * (-leak * refill + np.sqrt((leak * refill) ** 2 + 4.0 * supply))
    settled = signal(Leak(leak_per_s=leak, refill_s=refill, exponent=0.5), step_to(supply * FULL, 6000))[-1]
    np.testing.assert_allclose(settled, root**2 * FULL, rtol=1e-4)


def test_leak_that_opens_above_a_pressure_leaves_its_deficit_behind() -> None:
    """Air that has left is missing, and refilled, when the pressure falls below the one that opens the leak."""
    leak = Leak(leak_per_s=0.2, refill_s=3.0, above_share=0.5)
    high, low = step_to(0.8 * FULL, 2000), step_to(0.2 * FULL, 600)
    lacking = np.r_[high, low] - signal(leak, np.r_[high, low])
    always = high - signal(Leak(leak_per_s=0.2, refill_s=3.0), high)
    np.testing.assert_allclose(lacking[:2000], always, rtol=1e-9)
    np.testing.assert_allclose(lacking[2000:, 0], lacking[1999, 0] * np.exp(-DT / 3.0 * np.arange(1, 601)), rtol=1e-9)
    alone = signal(Leak(leak_per_s=0.2, refill_s=3.0, above_share=0.5, chamber=1), high)
    np.testing.assert_allclose(alone, np.stack([high[:, 0], high[:, 1] - always[:, 1], high[:, 2]], axis=1), rtol=1e-9)


@pytest.mark.parametrize(
    "valve",
    [Lag(0.5, 1.0), RateLimit(0.4, 0.4), FlowLimit(0.4, 0.5), Orifice(0.5, 0.5), PiRegulator(0.1, 0.5), TubeLine(0.6, 0.4),
     Deadband(0.05, 0.4, 0.6)],
    ids=lambda effect: effect.name(),
)  # fmt: skip
def test_a_valve_that_is_slow_above_a_pressure_vents_as_slowly_as_it_fills(valve: Effect) -> None:
    threshold, band = 0.3 * FULL, 0.05 * FULL
    command = np.vstack([step_to(0.0, 10), step_to(0.8 * FULL, 600), step_to(0.0, 600)])
    always, above = signal(valve, command)[:, 0], signal(replace(valve, above_share=0.3), command)[:, 0]
    down = 610 + int(np.argmax(always[610:] < threshold + band))
    np.testing.assert_allclose(above[:down], always[:down], atol=1e-9 * FULL)
    there = down + int(np.argmax(always[down:] < threshold))
    within = slice(down, there)
    assert (np.diff(above[down - 1 : there]) <= 0.0).all(), "through the band it only falls"
    assert (above[within] <= always[within] + 1e-9 * FULL).all()
    low = always[there:] < threshold  # a line rings
    assert not above[there:][low].any()
    near = np.vstack([step_to(0.5 * threshold, 100), step_to(0.0, 100)])
    np.testing.assert_array_equal(signal(replace(valve, above_share=0.3), near), near)


@pytest.mark.parametrize("turn", [0.5, 3.0, 6.2])
def test_a_frame_that_is_knocked_turns_on_its_way(turn: float) -> None:
    knocked = Frame(0.0, 0.0, turn, 0.1, 0.0, 0.0, since_s=1.0, over_s=1.0)
    tip = Rotation.from_rotvec([0.3, 0.5, 0.1]).as_quat(scalar_first=True)
    seen = signal(knocked, np.tile(np.r_[0.03, 0.0, 0.17, tip], (250, 1)))
    share = np.clip(DT * np.arange(1, 251) - 1.0, 0.0, 1.0)[:, None]
    part = Rotation.from_rotvec(share * [0.0, 0.0, turn])
    np.testing.assert_allclose(seen[:, :3], part.apply([0.03, 0.0, 0.17]) + share * [0.1 * ROBOT.length_m, 0.0, 0.0], atol=1e-12)
    turned = part * Rotation.from_quat(tip, scalar_first=True)
    np.testing.assert_allclose(seen[:, 3:], turned.as_quat(scalar_first=True), atol=1e-12)


@pytest.mark.parametrize("effect", [DeadTime(1.0), Delay(1.0), GaugeLag(0.0, 1.0)], ids=lambda effect: effect.name())
def test_a_delay_of_more_steps_than_are_remembered_is_refused(effect: Effect) -> None:
    sites = ["gauge" if isinstance(effect, GaugeLag) else effect.site]
    values = np.tile(np.eye(1, 7, 3), (3, 1)) if isinstance(effect, Delay) else np.zeros((3, 3))
    with pytest.raises(ConfigError, match=r"delay_s=1 s is 10000 steps of 0.0001 s; expected at most 4094: take steps of 0.0002"):
        SignalFilter(chain_of(ROBOT, [effect]), *sites).advance(values, 1e-4)
    SignalFilter(chain_of(ROBOT, [effect]), *sites).advance(values, 2.5e-4)


def test_what_is_late_above_a_pressure_arrives_late_when_it_is_vented_too() -> None:
    command = np.vstack([step_to(0.8 * FULL, 100), step_to(0.0, 100)])
    late = DeadTime(delay_s=0.3)
    np.testing.assert_allclose(signal(replace(late, above_share=0.3), command), signal(late, command), atol=1e-9 * FULL)


def test_gain_offset_crosstalk_are_linear_maps() -> None:
    command = np.array([[1e4, 2e4, -1e4]])
    np.testing.assert_allclose(signal(Gain(gain=0.8), command), 0.8 * command)
    np.testing.assert_allclose(signal(Gain(gain=0.8, chamber=1), command), [[1e4, 1.6e4, -1e4]])
    np.testing.assert_allclose(signal(Offset(offset=-0.1), command), command - 0.1 * FULL)
    np.testing.assert_allclose(signal(Crosstalk(share=0.1), command), [[1.1e4, 2e4, -0.7e4]])


def test_a_shift_stops_at_the_lowest_pressure() -> None:
    lowest = ROBOT.lowest_pa
    command = np.array([[0.0, lowest + 1e3, lowest - 1e3]])  # what is commanded below it is not the shift's concern
    expected = [[-0.1 * FULL, lowest, lowest - 1e3]]
    np.testing.assert_allclose(signal(Offset(offset=-0.1), command), expected)
    bent = replace(CommandMap.neutral(), b_1=-0.1, b_2=-0.1, b_3=-0.1)
    np.testing.assert_allclose(signal(bent, command), expected)
    np.testing.assert_allclose(signal(Offset(offset=0.1), command), command + 0.1 * FULL)


def test_area_growth_is_quadratic_and_odd() -> None:
    command = np.array([[1e4, 2e4, -1e4]])
    acting = signal(AreaGrowth(growth=0.7), command)
    np.testing.assert_allclose(acting - command, 0.7 * command * np.abs(command) / FULL)


def test_stiffness_scale_equals_a_stiffer_body() -> None:
    pressure = 2e4 * np.sin(0.02 * np.arange(500))[:, None] ** 2 * [1.0, 0.3, 0.0]
    body = simulator()
    stiffer = body.with_parameters(
        bending_stiffness_scale=1.7, axial_stiffness_scale=1.7, damping_s=body.damping_s / 1.7
    )
    np.testing.assert_allclose(
        move([StiffnessScale(scale=1.7)], pressure).position, move([], pressure, stiffer).position, atol=1e-8
    )


def test_stiffness_of_one_chamber_bends_the_others_way() -> None:
    even = np.full((600, 3), 2e4)
    assert np.abs(move([], even).position[-1, :2]).max() < 1e-6
    tip = move([StiffnessScale(scale=2.0, chamber=0)], even).position[-1, :2]
    # the stiff chamber stays short, so the tip bends towards it
    assert tip @ ROBOT.chamber_direction[0] > 0.99 * np.linalg.norm(tip) > 1e-3


@pytest.mark.parametrize("power", [0.7, 2.0, 4.0])
def test_strain_stiffening_follows_its_power_and_its_slope_is_exact(power: float) -> None:
    effect, strain = StrainStiffening(growth=1.5, power=power), np.array([0.02, 0.05, 0.15])
    np.testing.assert_allclose(pull(effect, strain), 1.5 * STIFFNESS * strain * (strain / 0.1) ** power, rtol=1e-9)
    by = 1e-7
    differences = (pull(effect, strain + by) - pull(effect, strain - by)) / (2 * by)
    np.testing.assert_allclose(differences, 1.5 * STIFFNESS * (1 + power) * (strain / 0.1) ** power, rtol=1e-6)


@pytest.mark.parametrize(("lean", "weights"), [(0.0, (1, 1)), (1.0, (2, 0)), (-1.0, (0, 2)), (0.5, (1.5, 0.5))])
def test_crosstalk_may_come_from_one_neighbour(lean: float, weights: tuple[float, float]) -> None:
    """Of four the one opposite counts less the more it leans; where all feel the others nothing does."""
    acting = signal(Crosstalk(share=0.1, lean=lean, chamber=1), np.array([[1e4, 0.0, 3e4]]))[0]
    np.testing.assert_allclose(acting, [1e4, 0.1 * (weights[0] * 3e4 + weights[1] * 1e4), 3e4])
    among_all = signal(Crosstalk(share=0.1, lean=lean), np.array([[1e4, 0.0, 3e4]]))[0]
    np.testing.assert_allclose(among_all, [1.3e4, 0.4e4, 3.1e4])
    four = replace(ROBOT, chamber_angle_deg=(0.0, 90.0, 180.0, 270.0))
    effect, values = Crosstalk(share=0.1, lean=lean, chamber=0), np.array([[1e4, 1e4, 2e4, 3e4]])
    opposite = 1.0 - abs(lean)
    acting = ends([effect], values, robot=four)[0]
    np.testing.assert_allclose(acting, [1e4 + 0.1 * ((1 + lean) * 1e4 + opposite * 2e4 + (1 - lean) * 3e4), 1e4, 2e4, 3e4])


def test_strain_stiffening_doubles_at_ten_percent_and_is_odd() -> None:
    added = pull(StrainStiffening(growth=1.0), np.array([0.1, -0.1, 0.05]))
    np.testing.assert_allclose(added, STIFFNESS * np.array([0.1, -0.1, 0.05 / 4]))


@pytest.mark.parametrize("slope", [-4.0, 3.0])
def test_an_area_that_changes_with_stretch_makes_pressure_a_stiffness(slope: float) -> None:
    """Along the axis ``K e = p (1 + slope e)``; against small bends pressures are springs of ``-slope p`` beside the backbone."""
    effect, strain = StretchArea(slope), np.array([0.05, -0.03, 0.1])
    np.testing.assert_allclose(pull(effect, strain, pressure=2e4), -slope * 2e4 * strain)
    body = replace(simulator(), robot=replace(ROBOT, gravity_m_s2=(0.0, 0.0, 0.0)))
    even, aside = np.full((800, 3), 1.5e4), np.tile([1e-3, 0.0, 0.0], (800, 1))
    bare, changed = (move(effects, even, body, tip_force=aside) for effects in ([], [effect]))
    longer = [motion.position[-1, 2] / ROBOT.length_m - 1.0 for motion in (bare, changed)]
    np.testing.assert_allclose(longer[1], longer[0] / (1.0 - slope * longer[0]), rtol=1e-5)
    turned = [Rotation.from_quat(motion.quaternion[-1], scalar_first=True).magnitude() for motion in (bare, changed)]
    springs = -slope * 1.5e4 * ROBOT.chamber_area_m2 * 1.5 * ROBOT.chamber_radius_m**2 / ROBOT.length_m
    softer = body.stiffness[0] / (body.stiffness[0] + springs) * (1.0 + longer[1]) / (1.0 + longer[0])
    np.testing.assert_allclose(turned[1] / turned[0], softer, rtol=1e-4)


def test_a_bimodular_wall_has_two_moduli() -> None:
    effect, strain = Bimodular(contrast=0.4, width=0.02), np.array([-0.3, -0.03, 0.01, 0.3])
    total = STIFFNESS * strain + pull(effect, strain)
    np.testing.assert_allclose(pull(effect, -strain), pull(effect, strain))
    further = STIFFNESS * (strain + 1e-6) + pull(effect, strain + 1e-6)
    np.testing.assert_allclose(((further - total) / 1e-6 / STIFFNESS)[[0, 3]], [0.6, 1.4], rtol=2e-3)


def test_strain_softening_levels_off_and_never_falls() -> None:
    strain = np.linspace(0.0, 2.0, 400)
    effect = StrainSoftening(softness=20.0 * FULL / STIFFNESS)
    total = STIFFNESS * strain + pull(effect, strain)
    assert (np.diff(total) > 0.0).all()
    np.testing.assert_allclose(total[-1], STIFFNESS / 20.0, rtol=1e-3)
    np.testing.assert_allclose(pull(effect, -strain), STIFFNESS * strain - total, atol=1e-9)


def test_strain_softening_keeps_its_residual_slope() -> None:
    strain = np.linspace(0.0, 2.0, 400)
    total = STIFFNESS * strain + pull(StrainSoftening(softness=50.0 * FULL / STIFFNESS, residual=0.1), strain)
    slope = np.diff(total) / np.diff(strain)
    assert (np.diff(slope) < 1e-6 * STIFFNESS).all()
    np.testing.assert_allclose(slope[[0, -1]], [STIFFNESS, 0.1 * STIFFNESS], rtol=0.03)


def test_a_wall_that_locks_is_stiff_then_soft_then_stiff() -> None:
    """Its slope falls to its least and rises again; without either half it is the other's law, in all chambers or in one."""
    effect, strain = Locking(softness=50.0 * FULL / STIFFNESS, growth=0.01, power=3.0), np.linspace(0.0, 0.6, 601)
    slope = np.gradient(STIFFNESS * strain + pull(effect, strain), strain) / STIFFNESS
    least = int(slope.argmin())
    assert 0.0 < slope[least] < 0.05 and slope[0] > 0.95 and slope[-1] > 1.0
    assert (np.diff(slope[1:least]) < 0.0).all() and (np.diff(slope[least + 1 : -1]) > 0.0).all()
    np.testing.assert_allclose(pull(effect, -strain), -pull(effect, strain))
    for chamber in (-1, 0):
        soft, stiff = StrainSoftening(3.0, 0.1, chamber), StrainStiffening(0.4, 1.5, chamber)
        np.testing.assert_allclose(pull(Locking(3.0, 0.1, 0.0, chamber=chamber), strain), pull(soft, strain))
        np.testing.assert_allclose(pull(Locking(0.0, 0.0, 0.4, 1.5, chamber), strain), pull(stiff, strain))
    assert not pull(Locking(3.0, 0.1, 0.4, 1.5, chamber=1), strain).any()


def test_viscoelastic_stress_relaxes_to_the_known_modulus() -> None:
    effect = Viscoelasticity(share_1=0.4, relaxation_1_s=2.0, share_2=0.2, relaxation_2_s=20.0)
    strain = np.full(4000, 0.05)
    added = pull(effect, strain)
    time = DT * np.arange(4000)
    expected = STIFFNESS * 0.05 * (0.4 * np.exp(-time / 2.0) + 0.2 * np.exp(-time / 20.0))
    np.testing.assert_allclose(added, expected, rtol=3e-3)  # the first step is a ramp, not a jump
    assert pull(effect, np.full(40, 0.05), dt_s=100.0)[-1] < 1e-6 * STIFFNESS


def test_creep_has_the_time_constant_of_relaxation_and_share() -> None:
    body = simulator().with_parameters(damping_s=1e-4, mass_scale=1e-3)
    effect = Viscoelasticity(share_1=0.5, relaxation_1_s=8.0, share_2=0.0, relaxation_2_s=1.0)
    pressure = np.full((6000, 3), 1e3) * [1.0, 0.0, 0.0]
    tip = move([effect], pressure, body).position[:, 1]
    final = move([], pressure, body).position[-1, 1]
    time = DT * np.arange(1, 6001)
    # at once 1 / (1 + share) of the bend, then an exponential approach with relaxation (1 + share)
    expected = final * (1.0 - 0.5 / 1.5 * np.exp(-time / (8.0 * 1.5)))
    np.testing.assert_allclose(tip[10:], expected[10:], rtol=4e-3)


def loop_width(effect: Effect, period_s: float, dt_s: float) -> float:
    """Return the width of the added pressure at zero strain of a settled triangle of 10 % strain."""
    phase = np.arange(1, round(3 * period_s / dt_s) + 1) * dt_s / period_s
    strain = 0.1 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * phase))
    added = pull(effect, strain, dt_s)[-round(period_s / dt_s) :]
    last = strain[-len(added) :]
    rising = np.gradient(last) > 0
    near = np.abs(last) < 0.01
    return float(added[rising & near].mean() - added[~rising & near].mean())


def test_bouc_wen_loop_has_a_width_free_of_rate_and_step() -> None:
    effect = Hysteresis(height=0.2, yield_strain=0.01)
    widths = [loop_width(effect, period, period / count) for period in (0.5, 5.0, 50.0) for count in (400, 800)]
    np.testing.assert_allclose(widths, 2 * 0.2 * FULL, rtol=2e-3)


def test_viscous_loop_depends_on_rate_where_bouc_wen_does_not() -> None:
    effect = Viscoelasticity(share_1=0.5, relaxation_1_s=1.0, share_2=0.0, relaxation_2_s=1.0)
    widths = [loop_width(effect, period, period / 400) for period in (0.5, 5.0, 50.0)]
    assert widths[1] > 1.5 * widths[0] and widths[1] > 1.5 * widths[2]


def test_play_is_backlash_between_pressure_and_strain() -> None:
    """Around an elastic wall the strain follows the pressure as the play operator says, at any rate and step."""
    height, yield_strain = 0.1, 0.001
    effect = Play(height=height, yield_strain=yield_strain)
    for count in (100, 1000):
        strain = np.concatenate([np.linspace(0, 0.1, count), np.linspace(0.1, 0.0, count)])
        pressure = STIFFNESS * strain + pull(effect, strain)
        up = np.interp(0.05, strain[:count], pressure[:count])
        down = np.interp(-0.05, -strain[count:], pressure[count:])
        np.testing.assert_allclose(up - down, 2 * height * FULL, rtol=1e-6)
    small = pull(effect, 0.0004 * np.sin(np.linspace(0, 20, 500)))
    assert np.abs(small - height * FULL / yield_strain * 0.0004 * np.sin(np.linspace(0, 20, 500))).max() < 1e-6 * FULL


def test_play_with_a_spread_yields_piece_by_piece_and_remembers_where_it_turned() -> None:
    """Sum of five stops: straight, then softer at each yield strain; an inner loop closes and leaves no trace (wiping out)."""
    effect = Play(height=0.1, yield_strain=0.01, spread=0.5)
    yields = 0.01 * np.array([0.6, 0.8, 1.0, 1.2, 1.4])
    strain = np.linspace(0.0, 0.02, 401)[1:]
    expected = FULL * 0.1 / 5 * np.minimum(strain[:, None], yields).sum(axis=1) / 0.01
    np.testing.assert_allclose(pull(effect, strain), expected, rtol=1e-9)
    out, back = np.linspace(0.02, 0.015, 101)[1:], np.linspace(0.015, 0.02, 101)[1:]
    onward = np.linspace(0.02, -0.02, 401)[1:]
    looped = pull(effect, np.concatenate([strain, out, back, onward]))[-400:]
    np.testing.assert_allclose(looped, pull(effect, np.concatenate([strain, onward]))[-400:], atol=1e-9 * FULL)


AROUND = np.asarray(ROBOT.chamber_direction)


def slipped(bend: np.ndarray) -> np.ndarray:
    """Return what four elements hold that are drawn by ``bend`` from rest, as a share of what all do at most."""
    return np.minimum(bend[:, None], 0.04 / 15.0 * np.array([1.0, 2.0, 4.0, 8.0])).sum(axis=1) / 0.04


def rubbed(bend: np.ndarray) -> np.ndarray:
    """Return likewise what bristles do."""
    return 1.0 - np.exp(-bend / 0.01)


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 2, 3.0])
@pytest.mark.parametrize(("law", "first"), [(BendSlip, slipped), (BendRub, rubbed)])
def test_what_holds_the_bend_is_the_same_whichever_way_the_body_bends(
    law: type[Effect], first: Callable[[np.ndarray], np.ndarray], angle: float
) -> None:
    """A bend is resisted along itself, by the height at most, a stretch not at all; a reversal gives back what was drawn."""
    effect, along = law(height=0.1, yield_strain=0.01), np.array([math.cos(angle), math.sin(angle)])
    bend = np.concatenate([np.linspace(0.0, 0.05, 201), np.linspace(0.05, 0.0, 201)])
    stretch = 0.3 * np.sin(40.0 * bend)
    added = pulls(effect, bend[:, None] * (AROUND @ along) + stretch[:, None])
    moment = added @ AROUND / 1.5
    np.testing.assert_allclose(added.sum(axis=1), 0.0, atol=1e-9 * FULL)
    np.testing.assert_allclose(moment @ [-along[1], along[0]], 0.0, atol=1e-9 * FULL)
    met = moment @ along
    np.testing.assert_allclose(met[:201], 0.1 * FULL * first(bend[:201]), atol=1e-9 * FULL)
    assert met[200] == pytest.approx(0.1 * FULL, rel=0.01) and met[-1] == pytest.approx(-0.1 * FULL, rel=0.02)


@pytest.mark.parametrize("count", [400, 4000])
@pytest.mark.parametrize("law", [BendSlip, BendRub])
def test_what_holds_the_bend_turns_after_it_and_loses_work_that_knows_no_rate(law: type[Effect], count: int) -> None:
    """Round a circle the pull keeps its height and lags behind the way; no closed path gives work."""
    effect, way = law(height=0.1, yield_strain=0.005), np.linspace(0.0, 4.0 * math.pi, count + 1)[1:]
    bend = 0.05 * np.column_stack([np.cos(way), np.sin(way)])
    moments = [pulls(effect, bend @ AROUND.T, dt_s) @ AROUND / 1.5 for dt_s in (0.01, 1.0)]
    np.testing.assert_allclose(moments[0], moments[1], atol=1e-9 * FULL)
    settled = moments[0][count // 2 :]
    assert np.hypot(*settled.T) == pytest.approx(0.1 * FULL, rel=1e-2)
    steps = np.diff(bend, axis=0)[count // 2 - 1 :]
    work = (settled * steps).sum(axis=1)
    assert (work > 0.0).all()
    assert work.sum() == pytest.approx(0.1 * FULL * 2.0 * math.pi * 0.05, rel=0.02)  # a circle's length at the full height


@pytest.mark.parametrize("angles", [(0.0,), (0.0, 180.0), (10.0, 100.0, 170.0), (0.0, 90.0, 180.0, 270.0)])
@pytest.mark.parametrize("kind", [BendSlip, BendRub])
def test_what_holds_the_bend_gives_back_no_work_that_it_did_not_take(kind: type[Effect], angles: tuple[float, ...]) -> None:
    """Wherever chambers stand, and whatever they do: what is taken is at least what the springs store, or nothing."""
    robot = replace(ROBOT, chamber_angle_deg=angles)
    law, rng, taken = kind(height=0.1, yield_strain=0.01), np.random.default_rng(3), [0.0]
    state, largest = law.reset(robot), 0.0
    for moved in 0.004 * rng.normal(size=(3000, robot.chambers)):
        port = body_port(robot.chambers)
        port[RATE] = moved / DT
        state, port = law.apply(robot, state, port, DT)
        taken.append(taken[-1] + float(port[ADDED] @ moved))
        largest = max(largest, np.abs(port[ADDED]).max())
        coupled = port[COUPLED:]
        assert np.linalg.eigvalsh(coupled + coupled.T).min() > -1e-6 * FULL
    assert min(taken) >= 0.0 and taken[-1] > 0.0
    assert 0.08 * FULL < largest <= 0.1 * FULL + 1e-9


@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_pressure_play_opens_a_loop_of_its_width_and_keeps_the_rest(spread: float) -> None:
    """Beyond all half-widths the loop is ``2 share half_width`` wide whatever they spread; small reversals move only the rest."""
    effect, far = PressurePlay(share=0.4, half_width=0.1, spread=spread), 0.8 * FULL
    up, down = np.linspace(0.0, far, 801)[1:], np.linspace(far, 0.0, 801)[1:]
    acts = signal(effect, np.repeat(np.concatenate([up, down])[:, None], 3, axis=1))[:, 0]
    middle = 0.4 * FULL
    width = np.interp(-middle, -down, acts[800:]) - np.interp(middle, up, acts[:800])
    assert width == pytest.approx(2 * 0.4 * 0.1 * FULL, rel=1e-6)
    slope = (acts[800] - acts[801]) / (down[0] - down[1])
    assert slope == pytest.approx(0.6, rel=1e-6)
    one = signal(replace(effect, chamber=1), np.repeat(up[:, None], 3, axis=1))
    np.testing.assert_array_equal(one[:, 0], up)
    assert np.abs(one[:, 1] - up).max() > 0.03 * FULL


@pytest.mark.parametrize("exponent", [0.1, 0.3, 0.6])
def test_power_creep_relaxes_by_a_power_of_time(exponent: float) -> None:
    effect, strain = PowerCreep(share=0.5, exponent=exponent), 0.05
    for dt_s, after in ((0.005, np.array([20, 50, 200, 800])), (0.5, np.array([20, 60, 200, 600]))):
        added = pull(effect, np.full(after[-1] + 1, strain), dt_s)[after]
        expected = STIFFNESS * strain * 0.5 * (after * dt_s) ** -exponent
        np.testing.assert_allclose(added, expected, rtol=0.1)


@pytest.mark.parametrize("effect", [PowerCreep(0.5, 0.2), Viscoelasticity(0.3, 2.0, 0.4, 30.0)])
def test_what_a_wall_has_not_relaxed_is_what_it_resists_after_a_hold(effect: Effect) -> None:
    strain, dt_s = 0.05, 0.5
    for steps in (20, 200, 2000):
        added = pull(effect, np.full(steps + 1, strain), dt_s)[-1]
        assert added == pytest.approx(STIFFNESS * strain * effect.unrelaxed(steps * dt_s), rel=0.02)


def test_asymmetry_turns_the_plane_of_bending_and_keeps_the_sum() -> None:
    command = np.full((1, 3), 1e4)
    acting = signal(Asymmetry(along_x=0.2, along_y=-0.1), command)[0]
    np.testing.assert_allclose(acting, 1e4 * (1.0 + ROBOT.chamber_direction @ [0.2, -0.1]))
    np.testing.assert_allclose(acting.sum(), command.sum())  # chambers evenly spread
    tip = move([Asymmetry(along_x=0.2, along_y=0.0)], np.full((600, 3), 2e4)).position[-1]
    assert tip[0] < -1e-3 and abs(tip[1]) < 1e-6  # away from the stronger side


def test_knee_bends_the_line_above_its_threshold_only() -> None:
    command = FULL * np.array([[0.2, 0.5, 1.0], [-0.2, -0.5, -1.0]])
    acting = signal(Knee(slope=0.5, threshold=0.5), command)
    np.testing.assert_allclose(acting, FULL * np.array([[0.2, 0.5, 0.75], [-0.2, -0.5, -0.75]]))


def test_failure_begins_at_its_onset_between_steps_too() -> None:
    acting = signal(Failure(loss=0.4, onset_s=0.505, chamber=1), step_to(1e4, 100))
    np.testing.assert_allclose(acting[:50], 1e4)
    np.testing.assert_allclose(acting[50], [1e4, 0.8e4, 1e4])
    np.testing.assert_allclose(acting[51:], np.tile([1e4, 0.6e4, 1e4], (49, 1)))


def test_gauge_changes_what_is_reported_and_can_be_undone() -> None:
    pressure = 2e4 * np.random.default_rng(0).uniform(-1, 1, (50, 3))
    for effect in (PressureSensor(gain=1.1, offset=0.03), PressureSensor(gain=0.9, offset=0.0, chamber=2)):
        motion, bare = move([effect, Lag(0.1, 0.1)], pressure), move([Lag(0.1, 0.1)], pressure)
        np.testing.assert_array_equal(motion.position, bare.position)
        always = np.ones((len(motion.pressure), 1))
        np.testing.assert_allclose(effect.undo(ROBOT, held(motion.pressure), always, DT).end, bare.pressure, atol=1e-9)
        shown = effect.gain * bare.pressure[:, 2] + effect.offset * FULL
        np.testing.assert_allclose(motion.pressure[:, 2], shown, atol=1e-9)


def test_a_slow_gauge_follows_the_pressure_and_can_be_undone() -> None:
    step = step_to(2e4, 200)
    for chamber in (-1, 1):
        effect = GaugeLag(time_s=0.1, chamber=chamber)
        motion, bare = move([effect], step), move([], step)
        np.testing.assert_array_equal(motion.position, bare.position)
        followed = 1.0 - np.exp(-DT * np.arange(1, 201) / 0.1)
        np.testing.assert_allclose(motion.pressure[:, 1], followed * 2e4, rtol=1e-9)
        assert np.array_equal(motion.pressure[:, 0], bare.pressure[:, 0]) == (chamber == 1)
        seen = effect.undo(ROBOT, held(motion.pressure), np.ones((200, 1)), DT).mean
        np.testing.assert_allclose(seen[1:], bare.pressure[1:], atol=1e-6)
        late = move([replace(effect, delay_s=0.05)], step).pressure
        np.testing.assert_array_equal(late[5:, 1], motion.pressure[:-5, 1])
        seen = replace(effect, delay_s=0.05).undo(ROBOT, held(late), np.ones((200, 1)), DT).mean
        np.testing.assert_allclose(seen[1:-5], bare.pressure[1:-5], atol=1e-6)


def test_drift_waits_for_its_onset() -> None:
    added = pull(Drift(rate_per_s=0.004, onset_s=5.0), np.full(1000, 0.05))
    assert not added[:500].any()
    np.testing.assert_allclose(added[500:], pull(Drift(rate_per_s=0.004), np.full(500, 0.05)), rtol=1e-9)


def test_a_wall_softens_with_the_recorded_temperature_only() -> None:
    """Its stiffness at whole seconds is ``exp(-a (T - 20))`` times the model's, halfway between them in between."""
    effect = ThermalSoftening(softening_per_k=0.02)
    port = body_port(3)
    port[ELASTIC], port[ELASTIC_SLOPE] = 1e3, 2e4
    for temperature, warm in ((None, 0.0), (np.array([26.0, 30.0]), 8.0), (np.array([30.0]), 10.0)):
        (hook,) = EffectChain(ROBOT, (effect,), temperature=temperature).hooks("body")
        seen = port.copy()
        hook.kernel(hook.parameters, hook.state, seen, 0.5, True)
        np.testing.assert_allclose(seen[ADDED], np.expm1(-0.02 * warm) * 1e3)
        np.testing.assert_allclose(seen[ADDED_SLOPE], np.expm1(-0.02 * warm) * 2e4)


def test_a_part_of_a_run_has_temperatures_of_its_own() -> None:
    """They are told from its first sample on, however long the run had gone on; what is timed by the run opens by that."""
    temperature = np.linspace(20.0, 30.0, 11)
    port = body_port(3)
    port[ELASTIC] = 1e3
    for since_s, share in ((0.0, 1.0), (296.0, 1.0), (304.0, 0.5)):
        effect = ThermalSoftening(softening_per_k=0.02, since_s=since_s, over_s=2.0, begun_s=300.0)
        (hook,) = EffectChain(ROBOT, (effect,), temperature=temperature).hooks("body")
        seen = port.copy()
        hook.kernel(hook.parameters, hook.state, seen, 5.0, True)
        np.testing.assert_allclose(seen[ADDED], share * np.expm1(-0.02 * 5.0) * 1e3)


def test_friction_loop_grows_with_pressure_not_with_rate() -> None:
    strain = 0.05 * np.sin(np.linspace(0, 20, 2000))
    for pressure, height in ((0.0, 0.1 * FULL), (1e4, 0.1 * FULL + 0.05 * 1e4)):
        for dt in (0.01, 0.1):
            added = pull(Friction(dry=0.1, loaded=0.05), strain, dt, pressure)
            np.testing.assert_allclose([added.max(), added.min()], [height, -height], rtol=1e-3)


def test_friction_holds_for_good() -> None:
    """Of a strain that is held nothing slips away, and a loop is as wide in an hour as in a second."""
    held = pull(Friction(dry=0.1, loaded=0.05), np.r_[np.linspace(0.0, 0.05, 50), np.full(1000, 0.05)], 1.0, pressure=1e4)
    np.testing.assert_allclose(held[10:], 0.1 * FULL + 0.05 * 1e4)
    wave = 0.05 * np.sin(np.linspace(0.0, 20.0, 2000))
    np.testing.assert_allclose(pull(Friction(0.1, 0.05), wave, 1e-3), pull(Friction(0.1, 0.05), wave, 10.0), rtol=1e-9)


def test_friction_holds_no_more_than_the_pressure_presses() -> None:
    law, state, added = Friction(dry=0.1, loaded=0.2), np.zeros(3), []
    for rate, pressure in [(1.0, 2e4), (0.0, 2e4), (0.0, 1e4), (0.0, 0.0), (0.0, 2e4), (-1.0, 2e4)]:
        port = body_port(3)
        port[RATE], port[PRESSURE] = rate, pressure
        state, port = law.apply(ROBOT, state, port, DT)
        added.append(port[ADDED, 0])
    dry, full = 0.1 * FULL, 0.1 * FULL + 0.2 * 2e4
    np.testing.assert_allclose(added, [full, full, dry + 0.2 * 1e4, dry, dry, -full])


@pytest.mark.parametrize("step", [1e-4, 1e-3, 0.05])
def test_friction_gives_back_no_energy_that_it_did_not_take(step: float) -> None:
    """Whatever strain and pressure do, and so over every loop of both: what it took is at least what its springs store."""
    rng, law = np.random.default_rng(2), Friction(dry=0.05, loaded=0.1)
    state, taken, slope = np.zeros(3), np.zeros(3), 0.0
    for _ in range(3000):
        moved, port = step * rng.normal(size=3), body_port(3)
        port[RATE], port[PRESSURE] = moved / DT, FULL * rng.uniform(-1.0, 1.0, size=3)
        state, port = law.apply(ROBOT, state, port, DT)
        taken, slope = taken + port[ADDED] * moved, max(slope, port[ADDED_SLOPE].max())
        assert slope == 0.0 or (taken >= port[ADDED] ** 2 / (2.0 * slope) - 1e-9).all()
    assert slope > 0.0 and (taken > 1.0).all()


def test_what_a_stuck_wall_gives_way_by_hardly_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    way = np.r_[np.linspace(0.0, 1.0, 150), np.full(50, 1.0), np.linspace(1.0, 0.3, 100), np.full(200, 0.3)]
    command, moved = FULL * way[:, None] * [0.0, 0.5, 1.0], []
    for strain in (1e-4, 0.5 * friction.YIELD_STRAIN, friction.YIELD_STRAIN):
        monkeypatch.setattr(friction, "YIELD_STRAIN", strain)
        moved.append(move([Friction(dry=0.05, loaded=0.05)], command).position)
    bare = move([], command).position
    stuck, way_m = np.linalg.norm(moved[0] - bare, axis=1)[-1], np.linalg.norm(np.ptp(bare, axis=0))
    left = [np.linalg.norm(one - moved[0], axis=1).max() for one in moved]
    assert left[1] < min(0.05 * stuck, 0.005 * way_m) and left[2] < min(0.1 * stuck, 0.01 * way_m), left


def test_mullins_acts_only_below_the_largest_strain() -> None:
    grid = np.linspace(0.0, 0.15, 76)
    up, down = grid[1:51], grid[:50][::-1]
    added = pull(Mullins(softening=0.3, width=0.05), np.concatenate([up, down, grid[1:]]))
    np.testing.assert_allclose(added[:50], 0.0, atol=1e-9)  # virgin
    assert (added[51:98] < 0.0).all() and (added[102:148] < 0.0).all()  # below the maximum, on both ways
    np.testing.assert_allclose(added[50:99][::-1], added[100:149], rtol=1e-3)  # the same on both
    np.testing.assert_allclose(added[151:], 0.0, atol=1e-9)  # beyond the maximum again


def test_mullins_softening_recovers_with_rest() -> None:
    stretched, rest = np.full(10, 0.1), np.zeros(round(20.0 / DT))
    # at half the strain a quarter of its energy is stored: three widths are missing at first, one after ln 2 recovery times
    for recovery_s, missing in ((1e6, 3.0), (20.0 / np.log(2.0), 1.0), (10.0, 0.0)):
        law = Mullins(softening=0.3, width=0.05, recovery_s=recovery_s)
        added = pull(law, np.concatenate([stretched, rest, [0.05]]))
        np.testing.assert_allclose(added[-1], 0.3 * np.expm1(-missing) * STIFFNESS * 0.05, rtol=0.02, atol=1e-9)


def test_drift_levels_off() -> None:
    """It begins at its rate and ends at ``exp(-rate T)``."""
    added = pull(Drift(rate_per_s=0.02, levels_s=5.0), np.full(10000, 0.05)) / (STIFFNESS * 0.05)
    np.testing.assert_allclose(added[9], -0.02 * 10 * DT, rtol=0.02)
    np.testing.assert_allclose(added[-1], np.expm1(-0.02 * 5.0), rtol=1e-6)


def test_drift_softens_exponentially() -> None:
    added = pull(Drift(rate_per_s=0.004), np.full(1000, 0.05))
    np.testing.assert_allclose(1.0 + added / (STIFFNESS * 0.05), np.exp(-0.004 * DT * np.arange(1, 1001)), rtol=1e-5)


def test_payload_weighs_as_its_force_and_slows_the_body() -> None:
    pressure = np.full((1500, 3), 2e4) * [1.0, 0.0, 0.0]
    weight = 0.3 * ROBOT.mass_kg * np.array(ROBOT.gravity_m_s2)
    loaded = move([Payload(mass=0.3)], pressure).position[-1]
    pressed = move([], pressure, tip_force=np.tile(weight, (1500, 1))).position[-1]
    np.testing.assert_allclose(loaded, pressed, atol=1e-7)
    light = simulator().with_parameters(damping_s=1e-3)

    def period(effects: list[Effect]) -> float:
        tip = move(effects, pressure[:400], light).position[:, 1]
        crossings = np.flatnonzero(np.diff(np.sign(tip - tip[-50:].mean())) != 0)
        return float(np.mean(np.diff(crossings[:6])))

    assert period([Payload(mass=0.3)]) > 1.3 * period([])


def load_port(tip: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    port = np.zeros((LOAD_PORT_ROWS, 3))
    port[TIP], port[TIP_VELOCITY], port[GRAVITY] = tip, velocity, [0.0, 0.0, -9.81]
    return port


def test_mount_tilt_turns_gravity_and_keeps_its_size() -> None:
    for angles, expected in (
        ((0.2, 0.0), [0, np.sin(0.2), -np.cos(0.2)]),
        ((0.0, 0.2), [-np.sin(0.2), 0, -np.cos(0.2)]),
    ):
        _, port = MountTilt(*angles).apply(ROBOT, np.zeros(3), load_port(np.zeros(3), np.zeros(3)), DT)
        np.testing.assert_allclose(port[GRAVITY], 9.81 * np.array(expected), atol=1e-12)


@pytest.mark.parametrize("law", [PowerCreep, Viscoelasticity])
def test_the_wall_of_one_chamber_creeps_by_its_own_spring(law: type[Effect]) -> None:
    """What holds a chamber in its place is in part other walls' pressure, which does not creep with its own."""
    added = []
    for elastic in (0.0, 4e3):
        effect = law.neutral(chamber=1)
        effect = replace(effect, **{f.name: f.metadata["typical"] for f in law.parameter_fields()})
        port = body_port(3)
        port[STRAIN], port[REST], port[ELASTIC], port[ELASTIC_SLOPE] = 0.05, STIFFNESS, elastic, STIFFNESS
        law.kernel(effect.pack(ROBOT), effect.reset(ROBOT), port, DT, True)
        added.append(port[ADDED].copy())
    np.testing.assert_array_equal(*added)
    assert added[0][1] > 0.0 and added[0][0] == added[0][2] == 0.0


def test_a_tilted_base_before_a_standing_camera_is_felt_and_seen() -> None:
    """The body moves as on a tilted mount, and a camera that stands still sees that motion turned by as much."""
    time = DT * np.arange(1, 201)
    command = np.tile([9e3, 2e3, 5e3], (200, 1))
    felt, seen = (
        Plant(simulator(), chain_of(ROBOT, [tilt])).simulate(time, command)
        for tilt in (MountTilt(0.3, -0.2), BaseTilt(0.3, -0.2))
    )
    down = MountTilt(0.3, -0.2).apply(ROBOT, np.zeros(3), load_port(np.zeros(3), np.zeros(3)), DT)[1][GRAVITY]
    base = Rotation.align_vectors([[0, 0, -1]], [down])[0]  # what the base has for down is down for the camera
    turn = Rotation.from_euler("xy", [0.3, -0.2]).inv()
    np.testing.assert_allclose((turn * base.inv()).apply([0, 0, 1]), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(seen.position, turn.apply(felt.position), atol=1e-12)


def test_contact_pushes_one_way_only() -> None:
    wall = Contact(distance=0.1, azimuth_rad=0.0, stiffness_n_per_m=500.0)
    edge = 0.1 * ROBOT.length_m
    for x, force in ((edge - 0.01, 0.0), (edge + 0.01, -5.0)):
        _, port = wall.apply(ROBOT, np.zeros(1), load_port(np.array([x, 0.3, 0.1]), np.zeros(3)), DT)
        np.testing.assert_allclose(port[FORCE], [force, 0.0, 0.0], atol=1e-12)


def test_wall_stops_the_tip() -> None:
    pressure = np.full((600, 3), 3e4) * [0.0, 1.0, 0.0]
    free = move([], pressure).position[-1]
    wall = Contact(distance=0.1, azimuth_rad=np.arctan2(free[1], free[0]), stiffness_n_per_m=1e4)
    stopped = move([wall], pressure).position[-1]
    normal = free[:2] / np.linalg.norm(free[:2])
    assert free[:2] @ normal > 0.15 * ROBOT.length_m
    assert abs(stopped[:2] @ normal - 0.1 * ROBOT.length_m) < 2e-3


def test_tether_force_is_the_gradient_of_a_spring() -> None:
    effect = Tether(stiffness_n_per_m=40.0, offset_x=0.1, offset_y=-0.1)
    anchor = ROBOT.length_m * np.array([0.1, -0.1, 1.0])
    tip = np.array([0.01, 0.02, 0.17])
    _, port = effect.apply(ROBOT, np.zeros(1), load_port(tip, np.zeros(3)), DT)
    np.testing.assert_allclose(port[FORCE], -40.0 * (tip - anchor))


@pytest.mark.parametrize("x", [0.05, 0.16])
def test_a_hose_is_slack_nearer_than_its_free_length_and_its_slope_is_the_derivative(x: float) -> None:
    effect = Tether(stiffness_n_per_m=40.0, offset_x=0.0, offset_y=0.0, free_length=0.5)
    tip = np.array([x, 0.02, ROBOT.length_m + 0.01])
    distance = np.linalg.norm(tip - [0.0, 0.0, ROBOT.length_m])
    _, port = effect.apply(ROBOT, np.zeros(1), load_port(tip, np.zeros(3)), DT)
    pull = 40.0 * max(distance - 0.5 * ROBOT.length_m, 0.0)
    assert np.linalg.norm(port[FORCE]) == pytest.approx(pull, abs=1e-12)
    for k in range(3):
        moved = [effect.apply(ROBOT, np.zeros(1), load_port(tip + step, np.zeros(3)), DT)[1][FORCE]
                 for step in np.eye(3)[k] * np.array([[1e-6], [-1e-6]])]  # fmt: skip
        assert (moved[0] - moved[1])[k] / 2e-6 == pytest.approx(port[FORCE_SLOPE + k, k], abs=1e-4)


SLOPED = [
    StiffnessScale(1.5),
    StiffnessScale(1.5, chamber=0),
    StrainStiffening(2.0),
    StrainSoftening(10.0),
    StretchArea(-3.0),
    Bimodular(0.4, 0.03),
    Viscoelasticity(0.4, 2.0, 0.2, 20.0),
    Hysteresis(0.2, 0.02),
    Play(0.2, 0.02),
    Play(0.2, 0.02, 0.5),
    PowerCreep(0.3, 0.3),
    Friction(0.1, 0.1),
    Mullins(0.3, 0.03),
    Drift(0.004),
]


@pytest.mark.parametrize("effect", SLOPED, ids=lambda e: e.name())
@pytest.mark.parametrize("strain", [0.03, 0.08, 0.0203])
def test_body_slope_is_the_derivative(effect: Effect, strain: float) -> None:
    state, last = effect.reset(ROBOT), 0.0

    def port_at(value: float, last: float) -> np.ndarray:
        port = body_port(3)
        port[STRAIN], port[RATE], port[PRESSURE] = value, (value - last) / DT, 1e4
        port[ELASTIC], port[ELASTIC_SLOPE], port[REST] = STIFFNESS * value, STIFFNESS, STIFFNESS
        return port

    for value in (0.01, 0.05, 0.02):
        type(effect).kernel(effect.pack(ROBOT), state, port_at(value, last), DT, True)
        last = value
    ports = [port_at(strain + nudge, last) for nudge in (-1e-7, 0.0, 1e-7)]
    for port in ports:
        type(effect).kernel(effect.pack(ROBOT), state, port, DT, False)
    slope = (ports[2][ADDED, 0] - ports[0][ADDED, 0]) / 2e-7
    np.testing.assert_allclose(ports[1][ADDED_SLOPE, 0], slope, rtol=2e-4, atol=1.0)


@pytest.mark.parametrize("far", [0.0005, 0.006, 0.05])
@pytest.mark.parametrize("kind", [BendSlip, BendRub])
def test_slope_of_what_holds_the_bend_is_the_derivative_by_every_strain(kind: type[Effect], far: float) -> None:
    """Where all elements hold, where some slip, and where all do."""
    law, moved = kind(height=0.1, yield_strain=0.01), far * np.array([1.0, 0.3, -0.4])
    state = law.reset(ROBOT)
    kind.kernel(law.pack(ROBOT), state, _moving(np.array([0.01, -0.02, 0.004])), DT, True)  # drawn in another direction
    seen = _moving(moved)
    kind.kernel(law.pack(ROBOT), state, seen, DT, False)
    for j in range(3):
        ports = [_moving(moved + nudge * np.eye(3)[j]) for nudge in (-1e-8, 1e-8)]
        for port in ports:
            kind.kernel(law.pack(ROBOT), state, port, DT, False)
        slope = (ports[1][ADDED] - ports[0][ADDED]) / 2e-8
        np.testing.assert_allclose([slope_of(seen, i, j) for i in range(3)], slope, rtol=1e-4, atol=1.0)


def _moving(strains: np.ndarray) -> np.ndarray:
    """Return a port whose chambers are strained by as much in one step."""
    port = body_port(3)
    port[STRAIN], port[RATE] = strains, strains / DT
    return port


@pytest.mark.parametrize(
    "effect", [Payload(0.3), Contact(0.1, 0.5, 500.0), Tether(40.0, 0.1, 0.0)], ids=lambda e: e.name()
)
def test_load_slope_is_the_derivative(effect: Effect) -> None:
    tip, velocity = np.array([0.05, 0.03, 0.17]), np.array([0.1, -0.2, 0.05])
    state = effect.reset(ROBOT)
    _, middle = effect.apply(ROBOT, state, load_port(tip, velocity), DT)
    for k in range(3):
        nudge = 1e-6 * np.eye(3)[k]
        forces = [
            effect.apply(ROBOT, state, load_port(tip + sign * nudge, velocity + sign * nudge / DT), DT)[1][FORCE]
            for sign in (-1.0, 1.0)
        ]
        np.testing.assert_allclose(
            middle[FORCE_SLOPE : FORCE_SLOPE + 3, k], (forces[1] - forces[0]) / 2e-6, rtol=1e-6, atol=1e-4
        )


def poses() -> np.ndarray:
    motion = move([], 3e4 * np.sin(0.03 * np.arange(1, 301))[:, None] ** 2 * [1.0, 0.4, 0.0])
    return np.hstack([motion.position, motion.quaternion])


def test_frame_is_an_isometry() -> None:
    pose = poses()
    turned = signal(Frame(0.1, -0.2, 0.5, 0.02, 0.0, 0.01), pose)
    distance = np.linalg.norm(pose[:, None, :3] - pose[None, ::10, :3], axis=2)
    np.testing.assert_allclose(
        np.linalg.norm(turned[:, None, :3] - turned[None, ::10, :3], axis=2), distance, atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.norm(turned[:, 3:], axis=1), 1.0)
    relative = np.sum(pose[0, 3:] * pose[:, 3:], axis=1)
    np.testing.assert_allclose(np.sum(turned[0, 3:] * turned[:, 3:], axis=1), relative, atol=1e-12)


@pytest.mark.parametrize("chamber_deg", [180.0, 90.0, 30.0])
def test_of_a_bend_angle_a_frame_tells_a_wrong_zero_and_nothing_else(chamber_deg: float) -> None:
    finger = replace(ROBOT, chamber_angle_deg=(chamber_deg,), output="bend_angle")
    x, y = finger.chamber_direction[0]
    bends = np.linspace(-2.0, 2.0, 9)
    pose = np.zeros((9, 7))
    pose[:, 3:] = Rotation.from_rotvec(bends[:, None] * [y, -x, 0.0]).as_quat(scalar_first=True)

    def reported(frame: Frame) -> np.ndarray:
        return bend_angle(finger, SignalFilter(chain_of(finger, [frame]), "sensor").advance(pose, DT)[:, 3:])

    np.testing.assert_allclose(bend_angle(finger, pose[:, 3:]), bends, atol=1e-12)
    across = Frame(0.5 * x, 0.5 * y, 1.2, 0.1, 0.2, 0.3)  # a free map of angles, were it to count
    np.testing.assert_allclose(reported(across), bends, atol=1e-12)
    np.testing.assert_allclose(reported(Frame(0.2 * y, -0.2 * x, 1.2, 0.0, 0.0, 0.0)), bends + 0.2, atol=1e-12)


def test_delay_shifts_the_pose_and_hold_repeats_it() -> None:
    pose = poses()
    np.testing.assert_allclose(signal(Delay(delay_s=0.05), pose)[5:], pose[:-5], atol=1e-12)
    np.testing.assert_allclose(signal(Delay(delay_s=0.05), pose)[:5], pose[[0]] * np.ones((5, 1)), atol=1e-12)
    held = signal(Hold(period_s=0.05), pose)
    np.testing.assert_allclose(held, np.repeat(pose[::5], 5, axis=0), atol=1e-12)
    between = signal(Hold(period_s=0.025), pose)
    np.testing.assert_allclose(between[3], 0.5 * (pose[2] + pose[3]), atol=1e-6)


def test_readings_are_counted_from_the_first_sample_also_after_a_time_before_it() -> None:
    pose = poses()
    effect = Hold(period_s=0.07)
    late = SignalFilter(EffectChain(ROBOT, (effect,), before_s=0.04), "sensor").advance(pose, DT)
    np.testing.assert_allclose(late[4:], signal(effect, pose[4:]), atol=1e-12)


@pytest.mark.parametrize("period_s", [0.07, 0.25, 0.613])
def test_a_reading_period_is_read_off_jumps_between_rests_and_off_nothing_else(period_s: float) -> None:
    rng, held, free = np.random.default_rng(5), [], []
    for run in range(3):
        time = np.sort(0.02 * np.arange(1500) + np.where(rng.uniform(size=1500) < 0.02, 0.006, 0.0))
        for into, seen in ((held, period_s * np.floor(time / period_s)), (free, time)):
            moved = np.sin(2.0 * np.pi * np.outer(seen, (0.05, 0.13, 0.21)) + run)
            into.append((time, moved + 0.01 * rng.standard_normal(moved.shape)))
    found = reading_period(held)
    assert found is not None and abs(found - period_s) * 30.0 / period_s < 0.02, "the last reading is off by a sample"
    assert reading_period(free) is None


@pytest.mark.parametrize("seed", range(5))
def test_bursts_with_pauses_between_are_no_readings_of_a_slow_sensor(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pause = np.where(np.arange(600) % 5 == 0, 1.05, 0.03)
    time = np.cumsum(pause + 0.001 * rng.uniform(size=600))
    moved = np.round(np.sin(0.4 * time), 2)  # in steps of the sensor, most samples repeat the one before
    assert reading_period([(time, moved[:, None])]) is None


def test_marker_keeps_its_distance_and_turns_with_the_tip() -> None:
    pose = poses()
    marked = signal(MarkerOffset(0.1, -0.05, 0.02), pose)
    offset = ROBOT.length_m * np.array([0.1, -0.05, 0.02])
    expected = pose[:, :3] + Rotation.from_quat(pose[:, 3:], scalar_first=True).apply(offset)
    np.testing.assert_allclose(marked[:, :3], expected, atol=1e-12)
    np.testing.assert_array_equal(marked[:, 3:], pose[:, 3:])


def test_flow_limit_fills_at_a_constant_rate_and_vents_in_proportion_to_the_pressure() -> None:
    effect, low = FlowLimit(rise_per_s=0.5, vent_s=0.8), min(ROBOT.pressure_min_pa, 0.0)
    supplied = signal(effect, np.vstack([step_to(FULL, 300), step_to(0.2 * FULL, 100)]))[:, 0]
    np.testing.assert_allclose(np.diff(supplied[:190]), 0.5 * FULL * DT)
    assert supplied[299] == FULL
    falling = supplied[299:350]
    np.testing.assert_allclose(falling - low, (FULL - low) * np.exp(-DT * np.arange(51) / 0.8))
    np.testing.assert_allclose(supplied[-1], 0.2 * FULL)


@pytest.mark.parametrize("high", [0.3 * FULL, FULL, 20.0 * FULL], ids=["a little", "full", "choked"])
def test_orifice_passes_what_iso_6358_lets_through(high: float) -> None:
    """Filling and venting of a constant volume, against the law itself, integrated; what is open is passed at once."""
    effect = Orifice(fill_s=0.3, vent_s=0.2)
    fill_s, vent_s = effect.pack(ROBOT)[:2]

    def law(p: float, command: float) -> float:
        upstream, downstream = (a + ATMOSPHERE_PA for a in (max(command, p), min(command, p)))
        ratio = max(downstream / upstream, CRITICAL)
        flow = math.sqrt(max(1.0 - ((ratio - CRITICAL) / (1.0 - CRITICAL)) ** 2, 0.0))
        tau = fill_s if command > p else vent_s
        return math.copysign((1.0 - CRITICAL) / tau * upstream * flow, command - p)

    steps = 60
    supplied = signal(effect, np.vstack([step_to(high, 300), step_to(0.0, steps)]))[:, 0]
    begin, expected = np.concatenate([[0.0], supplied[:-1]]), []
    for p, command in zip([*begin[:steps], *begin[300 : 300 + steps]], [high] * steps + [0.0] * steps, strict=True):
        fine = 2000
        for _ in range(fine):
            after = p + law(p, command) * DT / fine
            p = command if (after - command) * (p - command) <= 0.0 else after
        expected.append(p)
    np.testing.assert_allclose([*supplied[:steps], *supplied[300 : 300 + steps]], expected, atol=2e-3 * high)
    assert supplied[299] == pytest.approx(high) and supplied[0] < 0.5 * high
    if high == FULL:
        assert supplied[28] < FULL and supplied[30] == pytest.approx(FULL)
    np.testing.assert_array_equal(signal(Orifice(fill_s=0.0, vent_s=0.0), step_to(high, 5)), step_to(high, 5))
