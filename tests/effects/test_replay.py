"""A replay is neither early nor late, however unevenly the recording was stamped."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.span import held
from softrl.effects.chain import Plant, chain_of
from softrl.effects.command_map import CommandMap
from softrl.effects.deadband import Deadband
from softrl.effects.driving import Supply, drive_on_grid
from softrl.effects.effect import Effect
from softrl.effects.failure import Failure
from softrl.effects.gain import Gain
from softrl.effects.hold import Hold
from softrl.effects.lag import Lag
from softrl.effects.leak import Leak
from softrl.effects.pressure_sensor import PressureSensor
from softrl.effects.rate_limit import RateLimit
from softrl.effects.replay import replay
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from tests.effects.test_library import simulator


class Wire:
    """A body whose tip is the pressure, at the end of each step."""

    backward = True

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    def simulate(self, time, pressure, tip_force=None, body=(), load=()):  # type: ignore[no-untyped-def]
        from softrl.core.simulator import Motion

        turn = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
        return Motion(time, np.ascontiguousarray(pressure[:, :3]), turn, pressure)


class Creeping(Wire):
    """A body whose tip follows the pressure within 3 s."""

    def simulate(self, time, pressure, tip_force=None, body=(), load=()):  # type: ignore[no-untyped-def]
        creep = chain_of(self.robot, [Lag(3.0, 3.0)]).supplied(held(pressure), float(time[1] - time[0])).end
        return replace(super().simulate(time, pressure), position=creep)


class Turning(Wire):
    """A body whose tip turns by 10 rad/s in the plane of +x, whatever the pressure."""

    def simulate(self, time, pressure, tip_force=None, body=(), load=()):  # type: ignore[no-untyped-def]
        half = 5.0 * (time - time[0])
        turn = np.stack([np.cos(half), 0.0 * half, np.sin(half), 0.0 * half], axis=1)
        return replace(super().simulate(time, np.zeros((len(time), 3))), quaternion=turn)


ROBOT = Robot(
    name="wire", chamber_angle_deg=(-90.0, -210.0, -330.0), chamber_radius_m=0.05, chamber_area_m2=1e-3, length_m=0.2,
    mass_kg=1.0, pressure_min_pa=-1e4, pressure_max_pa=3e4, slew_pa_per_s=1e6, tip_force_max_n=1.0, axis="+z",
    output="tip_position", command="pressure", command_to_pa=1.0, gravity_m_s2=(0.0, 0.0, -9.81),
)  # fmt: skip


@pytest.mark.parametrize("dt_s", [0.02, 0.01, 0.005, 0.0025])
@pytest.mark.parametrize("uneven_s", [0.0, 2e-3])
def test_pressures_arrive_when_they_were_commanded(dt_s: float, uneven_s: float) -> None:
    rng = np.random.default_rng(3)
    time = np.cumsum(0.02 + uneven_s * rng.uniform(-1.0, 1.0, 3000))
    levels = 1e4 * rng.uniform(0.0, 1.0, (300, 3))
    command = np.repeat(levels, 10, axis=0)
    made = replay(Plant(Wire(ROBOT), chain_of(ROBOT, ())), Recording("run", "day", time, command), dt_s)
    assert made.pressure_meas is not None
    apart, slope = made.pressure_meas - command, np.gradient(command, time, axis=0)
    late_s = -float(np.sum(apart * slope) / np.sum(slope**2))
    assert abs(late_s) < (1e-9 if uneven_s == 0.0 else 0.6 * dt_s), late_s  # a step's own uncertainty
    assert np.abs(apart).max() < 1e-4 or uneven_s > 0.0


@pytest.mark.parametrize("early_s", [0.3, 0.7])
def test_a_command_that_came_early_acts_to_the_end(early_s: float) -> None:
    """The last row too is held until the recording ends: nothing was vented there."""
    time, command = 1.0 * np.arange(11), np.repeat([[1e4], [2e4]], [8, 3], axis=0) * np.ones(3)
    later = np.where(np.arange(11) < 7, 0.0, -early_s)
    grid, acts, _ = drive_on_grid(Recording("run", "day", time, command), 0.05, "command", 0.0, later=later)
    for part in acts:
        np.testing.assert_allclose(part, np.where(grid[:, None] > 7.0 - early_s + 1e-6, 2e4, 1e4) * np.ones(3))


def test_rows_that_come_at_one_time_act_in_their_order_beside_lost_ones() -> None:
    time = np.r_[0.1 * np.arange(30), 3.5 + 0.1 * np.arange(30)]
    command = 1e3 * np.arange(60)[:, None] * np.ones(3)
    later = np.repeat([0.07, -0.07], [20, 40])  # the second clock's first row comes no sooner than the first's last
    whole, part = (
        drive_on_grid(Recording("run", "day", time[:rows], command[:rows]), 0.01, "command", 0.0, later=later[:rows])[1].mean
        for rows in (60, 30)
    )
    np.testing.assert_allclose(whole[:280], part[:280])


@pytest.mark.parametrize("lost", [1, 5, 40])
def test_a_command_is_not_early_by_the_rows_that_a_log_has_lost(lost: int) -> None:
    time = 0.02 * np.arange(1, 1001)
    command = 5e3 * (1.0 + np.sin(np.outer(time, [1.1, 0.7, 0.4])))
    kept = np.ones(len(time), dtype=bool)
    kept[300 : 300 + lost] = kept[700 : 700 + lost] = False
    whole, fewer = (
        drive_on_grid(Recording("run", "day", time[rows], command[rows]), 0.01, "command", 0.0)[1].mean
        for rows in (np.ones(len(time), dtype=bool), kept)
    )
    even = 0.125 * 6.1e3 * (0.02 * (lost + 1)) ** 2  # what a line may be off between the ends, of its curvature
    assert np.abs(fewer - whole)[200:].max() < even + 120.0, "a row is up to 110 Pa"


@pytest.mark.parametrize("lost_s", [3.0, 30.0])
def test_a_log_that_waits_has_held_its_command(lost_s: float) -> None:
    time = np.concatenate([0.02 * np.arange(1, 101), 2.0 + lost_s + 0.02 * np.arange(1, 101)])
    command = np.repeat([[1e4, 0.0, 0.0], [2e4, 0.0, 0.0]], 100, axis=0)
    drive = drive_on_grid(Recording("run", "day", time, command), 0.02, "command", 0.0)[1].mean
    assert set(np.unique(drive[1:-1, 0]).round(6)) == {1e4, 2e4}


@pytest.mark.parametrize("uneven_s", [0.0, 0.02])
def test_measured_pressures_change_evenly_between_their_samples(uneven_s: float) -> None:
    time = np.cumsum(0.1 + uneven_s * np.random.default_rng(3).uniform(-1.0, 1.0, 300))

    def swings(at: np.ndarray) -> np.ndarray:
        return 1e4 * np.sin(np.outer(at, [1.1, 0.7, 0.4]))

    seldom = Recording("run", "day", time, np.zeros((300, 3)), pressure_meas=swings(time))
    grid, drive, _ = drive_on_grid(seldom, 0.005, "measured", 0.0)
    within = (grid > time[0]) & (grid < time[-1])
    np.testing.assert_allclose(drive.end[within], swings(grid[within]), atol=40.0)  # held, they are up to 1200 Pa early
    np.testing.assert_allclose(drive.mean[within], swings(grid[within] - 0.0025), atol=40.0)


@pytest.mark.parametrize("late_s", [0.0, 0.1])
def test_forces_act_when_they_were_measured_however_late_commands_are(late_s: float) -> None:
    time = 0.1 * np.arange(1, 301)

    def swings(at: np.ndarray) -> np.ndarray:
        return np.sin(np.outer(at, [1.1, 0.7, 0.4]))

    seldom = Recording("run", "day", time, np.zeros((300, 3)), tip_force=swings(time))
    grid, _, force = drive_on_grid(seldom, 0.005, "command", 0.0, late_s)
    within = (grid > time[0]) & (grid < time[-1])
    assert force is not None
    np.testing.assert_allclose(force.mean[within], swings(grid[within] - 0.0025), atol=0.004)  # held, they are up to 0.11 N early


@pytest.mark.parametrize("period_s", [0.013, 0.07, 0.4])
def test_a_slow_sensor_reports_the_pose_of_its_last_reading_whatever_the_step(period_s: float) -> None:
    time = np.cumsum(0.02 + 2e-3 * np.random.default_rng(3).uniform(-1.0, 1.0, 1000))
    since = time - time[0]
    command = 1e4 * np.sin(np.outer(time, [1.1, 0.7, 0.4]))
    run = Recording("run", "day", time, command)
    bare, held = (Plant(Wire(ROBOT), chain_of(ROBOT, effects)) for effects in ((), (Hold(period_s=period_s),)))
    free = replay(bare, run, 0.005).position
    assert free is not None
    read = np.stack([np.interp(period_s * np.floor(since / period_s + 1e-6), since, column) for column in free.T], axis=1)
    for dt_s in (0.005, 0.01):
        np.testing.assert_allclose(replay(held, run, dt_s).position, read, atol=0.03 * np.abs(free).max())
    grid = 0.001 * np.arange(3000)
    pressure = 1e4 * np.sin(np.outer(grid, [1.1, 0.7, 0.4]))
    stepwise = held.simulate(grid, pressure).position  # the kernel, that a rig runs by
    at = period_s * np.floor(grid / period_s + 1e-6)
    np.testing.assert_allclose(stepwise, 1e4 * np.sin(np.outer(at, [1.1, 0.7, 0.4])), atol=20.0)


@pytest.mark.parametrize("dt_s", [0.01, 0.04])
def test_a_bend_angle_between_two_steps_is_that_of_a_turn(dt_s: float) -> None:
    """Half way between two poses an even turn about one axis is half done, on beyond half a turn too."""
    finger = replace(ROBOT, chamber_angle_deg=(180.0,), output="bend_angle")
    time = np.r_[0.0, dt_s * (np.arange(1, 40) - 0.5)]
    run = Recording("run", "day", time, np.zeros((40, 1)), bend_angle=10.0 * time)
    np.testing.assert_allclose(replay(Plant(Turning(finger), chain_of(finger, ())), run, dt_s).bend_angle, 10.0 * time, atol=1e-9)


ONSETS = [Failure(0.4, 2.0), Gain(0.6, since_s=2.0, over_s=0.1), PressureSensor(0.6, 0.0, since_s=2.0, over_s=0.1)]


@pytest.mark.parametrize("effect", ONSETS, ids=lambda effect: effect.name())
@pytest.mark.parametrize("dt_s", [0.05, 0.01, 0.0025])
@pytest.mark.parametrize("settle_s", [0.0, 1.0])
def test_what_begins_at_a_time_does_so_whatever_the_step(effect: Effect, dt_s: float, settle_s: float) -> None:
    """Two seconds after the first row, which may be stamped anything, and not a step before."""
    since = 0.05 * np.arange(81)
    run = Recording("run", "day", 7.0 + since, np.full((81, 3), 1e4), pressure_meas=np.full((81, 3), 1e4))
    plant = Plant(Wire(ROBOT), chain_of(ROBOT, [effect]))
    share = np.clip((since - 2.0) / (0.1 if effect.since_s else 1e-9), 0.0, 1.0)
    made = replay(plant, run, dt_s, settle_s=settle_s)
    assert made.position is not None and made.pressure_meas is not None
    changed = made.pressure_meas if effect.channel == "pressure" else made.position
    np.testing.assert_allclose(changed[:, 0], 1e4 * (1.0 - 0.4 * share), atol=1e-3)
    if effect.channel == "pressure":
        driven = replay(plant, run, dt_s, drive="measured", settle_s=settle_s).position
        np.testing.assert_allclose(driven[:, 0], 1e4 / (1.0 - 0.4 * share), atol=1e-3)


def cut(effects: list[Effect], from_s: float) -> tuple[Plant, Recording]:
    """Return a plant, and what is left of a run with it that is cut under pressure."""
    time = 0.01 * np.arange(6000)
    steps = 1e4 * np.array([[0.0, 0.0, 0.0], [1.5, 0.5, 1.0], [0.3, 1.5, 0.0], [2.0, 1.0, 0.5]])
    command = steps[np.searchsorted([1.0, 40.0, 50.0], time, side="right")]
    plant = Plant(Creeping(ROBOT), chain_of(ROBOT, effects))
    made = replay(plant, Recording("run", "day", time, command), 0.01)
    rows, of = time >= from_s - 1e-6, ("time", "pressure_cmd", "pressure_meas", "position", "quaternion")
    left = {name: getattr(made, name)[rows] for name in of}
    return plant, replace(made, **left)


MAP = replace(CommandMap.neutral(), a_11=0.3, a_12=0.2, b_1=0.1)
HIDDEN = [
    [Gain(0.7, before_gauge=True)], [MAP], [Leak(0.3, 3.0, before_gauge=True)], [Deadband(0.1)], [PressureSensor(1.5, 0.1)],
    [MAP, PressureSensor(1.5, 0.1)],
]  # fmt: skip


@pytest.mark.parametrize("effects", HIDDEN, ids=lambda effects: "+".join(effect.name() for effect in effects))
def test_a_run_that_begins_under_pressure_begins_alike_with_a_gauge_and_without(effects: list[Effect]) -> None:
    """What is measured is what a valve gave: for its command it gives that once more, less or more."""
    plant, left = cut(effects, 30.0)
    for run in (left, replace(left, pressure_meas=None)):
        again = replay(plant, run, 0.01, settle_s=20.0)
        np.testing.assert_allclose(again.pressure_meas, left.pressure_meas, atol=20.0)
        np.testing.assert_allclose(again.position, left.position, atol=40.0)


@pytest.mark.parametrize("effect", [Lag(2.0, 2.0), RateLimit(0.1, 0.1)], ids=lambda effect: effect.name())
def test_a_run_that_begins_while_a_chamber_fills_begins_where_its_gauge_shows_it(effect: Effect) -> None:
    plant, left = cut([effect], 41.0)
    assert left.pressure_meas is not None
    assert np.abs(left.pressure_meas[0] - left.pressure_cmd[0]).max() > 3e3
    np.testing.assert_allclose(replay(plant, left, 0.01, settle_s=20.0).pressure_meas, left.pressure_meas, atol=60.0)


def test_a_valve_that_is_understood_begins_at_what_was_measured() -> None:
    plant, left = cut([Leak(0.3, 3.0, before_gauge=True), MAP], 30.0)
    assert left.pressure_meas is not None
    supply = Supply(plant.chain, 0.0, np.zeros_like(left.pressure_meas))
    grid, drive, _ = drive_on_grid(left, 0.01, "measured", 20.0, supply=supply)
    np.testing.assert_allclose(drive.end[grid > left.time[0] - 0.005], left.pressure_meas, atol=20.0)


@pytest.mark.parametrize("slow_s", [0.1, 0.2, 0.5])
def test_commands_are_held_where_a_log_is_written_more_slowly(slow_s: float) -> None:
    """Rows that it loses there are as any others: the command changes evenly across them."""
    time = np.r_[0.02 * np.arange(1, 1001), 20.0 + slow_s * np.arange(1, 41)]
    command = 5e3 * (1.0 + np.sin(np.outer(time, [1.1, 0.7, 0.4])))
    grid, (acts, _), _ = drive_on_grid(Recording("run", "day", time, command), 0.01, "command", 0.0)
    held = command[np.searchsorted(time, grid - 1e-6)]
    np.testing.assert_allclose(acts[1:-1], held[1:-1], atol=60.0)
    kept = np.arange(len(time)) != 1020
    grid, (acts, _), _ = drive_on_grid(Recording("run", "day", time[kept], command[kept]), 0.01, "command", 0.0)
    lost = (grid > time[1019] + 1e-6) & (grid < time[1021] - 1e-6)
    levels = np.unique(acts[lost].round(3), axis=0)
    np.testing.assert_allclose(levels.mean(axis=0), 0.25 * command[1019] + 0.75 * command[1021], atol=1.0)


@pytest.mark.parametrize("drive", ["command", "measured"])
@pytest.mark.parametrize(
    "valve", [Lag(0.005, 0.02), Lag(0.05, 0.05), Lag(0.05, 0.05, behind_gauge=True)], ids=["fast", "slow", "line"]
)
def test_a_body_behind_a_slow_valve_moves_alike_whatever_the_step(valve: Lag, drive: str) -> None:
    """With what stands behind the valve at the end of each step of 10 ms it would be 5 ms early, 1 mm.

    What was measured tells by the commands whether a pressure jumped between two samples or came slowly.
    """
    body, time = simulator(), 0.01 * np.arange(1, 801)
    levels = body.robot.pressure_max_pa * np.random.default_rng(2).uniform(0.0, 0.9, (80, body.robot.chambers))
    levels[0] = 0.0
    run = Recording("run", "day", time, np.repeat(levels, 10, axis=0))
    plant = Plant(body, chain_of(body.robot, [valve]))
    true = replay(plant, run, 0.001)
    seen = replay(plant, true, 0.01, drive=drive, channels=("position",)).position
    assert np.sqrt(np.mean(np.sum((seen - true.position) ** 2, axis=1))) < 6e-5
