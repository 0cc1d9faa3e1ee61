"""Replay a recording's commands through a plant, and sample the result when the recording was sampled."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import groupby
from typing import TypeGuard

import numba as nb
import numpy as np

from softrl.core.errors import ConfigError
from softrl.core.identity import Same
from softrl.core.simulator import Motion
from softrl.core.span import Span, after, held
from softrl.effects.chain import EffectChain, Plant, simulate_batch
from softrl.effects.driving import Supply, drive_on_grid
from softrl.effects.effect import EVERYWHERE, Effect
from softrl.effects.gate import share_at
from softrl.effects.hold import Hold, reading_phase
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

CHANNELS = ("pressure_meas", "position", "quaternion", "bend_angle")
KEPT = 128  # recordings whose pressures on the grid are kept


def replay(
    plant: Plant,
    recording: Recording,
    dt_s: float,
    drive: str = "command",
    settle_s: float = 0.0,
    before: Sequence[float] | None = None,
    channels: Sequence[str] = CHANNELS,
    late_s: float = 0.0,
    supply: Supply | None = None,
    later: np.ndarray | None = None,
) -> Recording:
    """Return what the plant's sensors report under a recording's commands, at the recording's times.

    Parameters
    ----------
    plant : body with effects
    recording : its times need not be uniform; its commands are held until their time, as in
        ``Simulator.simulate``
    dt_s : step of the uniform grid on which the plant is simulated, s
    drive : "command" sends the commands through the valve; "measured" puts the measured pressure behind the
        valve, which tests the body apart from the valve; between its samples it changes evenly, or as one that makes for its
        command does
    settle_s : time before the first sample during which the plant is held under the first row, for a recording that does
        not begin at rest; a valve so that it gives what was measured there, if that is, see ``EffectChain.stood_under``
    before : (chambers,) Pa that act on the body during that time instead, where its past was another; without a measured
        pressure the valve too stood under them
    channels : which are wanted; the others are None, and cost nothing
    late_s : how long after its time each row still acts, where a log was written so
    supply : the valve, where it is understood: at ten samples a second most of what it does to a step is over before the next
    later : (samples,) s by which each row's command acts later still, where commands were sent by another clock

    Returns
    -------
    Recording
        Of the same name, session, times, commands, tip force and temperature. ``pressure_meas``, ``position``,
        ``quaternion`` are simulated; ``bend_angle`` is derived from the pose if the recording has it or the
        robot reports it. Markers are left out.

    Notes
    -----
    Between grid points positions are interpolated linearly, quaternions likewise and normalised; pressures are held.
    """
    return replay_batch(
        [plant], recording, dt_s, drive, settle_s, before=before, channels=channels, late_s=late_s, supply=supply, later=later
    )[0]


def replay_batch(
    plants: Sequence[Plant],
    recording: Recording,
    dt_s: float,
    drive: str = "command",
    settle_s: float = 0.0,
    workers: int = 1,
    before: Sequence[float] | None = None,
    channels: Sequence[str] = CHANNELS,
    late_s: float = 0.0,
    supply: Supply | None = None,
    later: np.ndarray | None = None,
) -> list[Recording]:
    """Return what ``replay`` returns for each of ``plants``, whose robot is the same; see ``simulate_batch``."""
    time, pressure, force = _kept_on_grid(Same(recording), dt_s, drive, settle_s, late_s, Same(supply), Same(later))
    past = None if before is None else np.tile(np.asarray(before, dtype=float), (round(settle_s / dt_s), 1))
    if past is not None and drive == "command" and recording.pressure_meas is None:
        pressure, past = after(past, pressure), None
    taken = [_taken_at(plant.chain, recording) for plant in plants]
    before_s = settle_s + dt_s  # a run begins a step before its first row, which is where that step has led
    plants = [_under(plant, before_s, _each_second(Same(recording))) for plant in plants]
    if drive == "command":
        first = None if recording.pressure_meas is None else (round(settle_s / dt_s), recording.pressure_meas[0])
        motions = simulate_batch(plants, time, pressure, force, workers, past, first)
    else:
        behind, robot = [_behind_valve(plant) for plant in plants], plants[0].chain.robot
        motions = []
        for gauges, group in groupby(range(len(plants)), lambda k: plants[k].chain.gauges):
            at_rows = [] if supply is not None else [gauge for gauge in gauges if not gauge.flows]
            reported = pressure
            if at_rows and recording.pressure_meas is not None:  # how pressures go between rows is told by them and commands
                rows = _seen_by(at_rows, robot, held(recording.pressure_meas), recording.time - recording.time[0], dt_s).mean
                _, reported, _ = drive_on_grid(replace(recording, pressure_meas=rows), dt_s, drive, settle_s, late_s)
            slow = [gauge for gauge in gauges if gauge not in at_rows]
            seen = _seen_by(slow, robot, reported, dt_s * np.arange(len(time)) - settle_s, dt_s)
            motions += simulate_batch([behind[k] for k in group], time, seen, force, workers, past)
    robot = plants[0].chain.robot
    pairs = zip(motions, taken, strict=True)
    return [_reported(recording, robot, time, dt_s, motion, when, channels) for motion, when in pairs]


def _under(plant: Plant, before_s: float, temperature: np.ndarray | None) -> Plant:
    """Return the plant without readers of sensors, its clocks and surroundings those of a run that went on ``before_s``."""
    effects = _without_readers(plant.chain)
    return replace(plant, chain=replace(plant.chain, effects=effects, before_s=before_s, temperature=temperature))


@lru_cache(maxsize=KEPT)
def _each_second(same: Same[Recording]) -> np.ndarray | None:
    """Return the recorded temperature, degree Celsius, at whole seconds from the first sample on; None without one."""
    run = same.thing
    if run.temperature is None:
        return None
    since = run.time - run.time[0]
    return np.interp(np.arange(int(np.ceil(since[-1])) + 1), since, run.temperature)


def _reads(effect: Effect) -> TypeGuard[Hold]:
    """Return whether an effect is nothing but the times at which a sensor is read."""
    return isinstance(effect, Hold) and not effect.gated


def _without_readers(chain: EffectChain) -> tuple[Effect, ...]:
    return tuple(effect for effect in chain.effects if not _reads(effect))


def _taken_at(chain: EffectChain, recording: Recording) -> tuple[np.ndarray, float]:
    """Return when (samples,) s the poses were taken that are reported at a recording's times, and how much earlier at most, s.

    Exact whatever the step: a staircase on the grid would be early or late by up to a step at every jump.
    """
    since, open_s = recording.time - recording.time[0], 0.0
    for effect in reversed(chain.at("sensor")):
        if _reads(effect):
            phase = reading_phase(Same(recording), effect.period_s)
            since, open_s = effect.taken_at(since, phase.latest_s), phase.open_s
    return np.asarray(since + recording.time[0]), open_s


def _as_measured(
    recording: Recording, robot: Robot, time: np.ndarray, dt_s: float, motion: Motion, taken: tuple[np.ndarray, float]
) -> np.ndarray:
    """Return when (samples,) s poses were taken, all so much earlier than at the latest as is nearest what was measured.

    Rows tell when a camera was read to within the time between them, and where its period is a whole number of rows no better
    in all of a run. What was measured may be turned, moved and of another size.
    """
    latest, open_s = taken
    measured = recording.position if recording.position is not None else recording.bend_angle
    if open_s <= 0.0 or measured is None:
        return latest
    ends = []
    for when in (latest, latest - open_s):
        if recording.position is not None:
            ends.append(_sampled(when, time, dt_s, motion.position))
        else:
            ends.append(_bent(robot, when, time, dt_s, motion.quaternion)[:, None])
    late, early, seen = (rows - rows.mean(axis=0) for rows in (*ends, measured.reshape(len(latest), -1)))
    middle, back = 0.5 * (late + early), early - late
    if not np.isfinite(middle).all():
        return latest
    u, _, vt = np.linalg.svd(middle.T @ seen)
    u[:, -1] *= np.sign(np.linalg.det(u @ vt))
    size, moved = np.linalg.lstsq(np.stack([middle, back], axis=2).reshape(-1, 2), (seen @ (u @ vt).T).ravel())[0]
    share = 0.5 + (moved / size if size > 0.0 else 0.0)
    return np.asarray(latest - open_s * min(max(share, 0.0), 1.0))


@lru_cache(maxsize=KEPT)
def _kept_on_grid(
    same: Same[Recording],
    dt_s: float,
    drive: str,
    settle_s: float,
    late_s: float,
    supply: Same[Supply | None],
    later: Same[np.ndarray | None],
) -> tuple[np.ndarray, Span, Span | None]:
    """Return what drives a recording on the grid, kept: fits replay the same few recordings thousands of times."""
    return drive_on_grid(same.thing, dt_s, drive, settle_s, late_s, supply.thing, later.thing)


def _reported(
    recording: Recording,
    robot: Robot,
    time: np.ndarray,
    dt_s: float,
    motion: Motion,
    taken: tuple[np.ndarray, float],
    channels: Sequence[str],
) -> Recording:
    """Return ``recording`` with ``motion``, known on the grid ``time`` of step ``dt_s``, in place of what was measured.

    Poses are those that were ``taken`` at times (samples,) s at the latest, and by so much earlier at most.
    """
    taken_at = _as_measured(recording, robot, time, dt_s, motion, taken)
    reports_angle = "bend_angle" in channels and (robot.output == "bend_angle" or recording.bend_angle is not None)
    return replace(
        recording,
        pressure_meas=_held(recording.time, time, dt_s, motion.pressure) if "pressure_meas" in channels else None,
        position=_sampled(taken_at, time, dt_s, motion.position) if "position" in channels else None,
        quaternion=_turned(taken_at, time, dt_s, motion.quaternion) if "quaternion" in channels else None,
        bend_angle=_bent(robot, taken_at, time, dt_s, motion.quaternion) if reports_angle else None,
        markers={},
        unseen=None,
    )


def _bent(robot: Robot, wanted: np.ndarray, time: np.ndarray, dt_s: float, quaternion: np.ndarray) -> np.ndarray:
    """Return the bend angle (samples,) rad at the times ``wanted``; the steps of the grid tell how often it has gone round."""
    angle, counted = bend_angle(robot, _turned(wanted, time, dt_s, quaternion)), bend_angle(robot, quaternion)
    counted = _sampled(wanted, time, dt_s, counted[:, None])[:, 0]
    return np.asarray(angle + 2.0 * np.pi * np.round((counted - angle) / (2.0 * np.pi)))


def bend_angle(robot: Robot, quaternion: np.ndarray) -> np.ndarray:
    """Return the angle (steps,) rad between the tip's axis and the base's z axis.

    Where all chambers lie on one line it has a sign: positive where pressure in chamber 1 bends the tip. It is then counted on
    beyond half a turn, from a first step less than that on.
    """
    w, x, y, z = quaternion.T
    tangent = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
    if robot.bends_in_a_plane:
        return np.unwrap(np.arctan2(-tangent[:, :2] @ robot.chamber_direction[0], tangent[:, 2]))
    return np.arctan2(np.hypot(tangent[:, 0], tangent[:, 1]), tangent[:, 2])


def _behind_valve(plant: Plant) -> Plant:
    return replace(plant, chain=replace(plant.chain, effects=plant.chain.at("chamber", "body", "load", "sensor")))


def _seen_by(gauges: Sequence[Effect], robot: Robot, reported: Span, since_s: np.ndarray, dt_s: float) -> Span:
    """Return the pressures that gauges ``reported`` as these, ``since_s`` (steps,) the first sample.

    Raises
    ------
    ConfigError
        If a gauge errs above a pressure only: what it saw does not follow from what it reported.
    """
    for gauge in reversed(gauges):
        if gauge.above_share > EVERYWHERE:
            raise ConfigError(
                f"effect {gauge.name()}.above_share={gauge.above_share:g}: measured pressures cannot drive a body behind a gauge "
                "that errs above a pressure only; expected drive=command"
            )
        reported = gauge.undo(robot, reported, share_at(gauge, since_s)[:, None], dt_s)
    return reported


def _sampled(wanted: np.ndarray, time: np.ndarray, dt_s: float, values: np.ndarray) -> np.ndarray:
    """Return the columns of ``values`` (steps, n), interpolated linearly from ``time`` to ``wanted``.

    The step is told, for a difference of large times is a little wrong, and every step adds to it.
    """
    place = (wanted - time[0]) / dt_s
    return _interpolated(place, np.ascontiguousarray(values))


def _turned(wanted: np.ndarray, time: np.ndarray, dt_s: float, quaternion: np.ndarray) -> np.ndarray:
    """Return unit quaternions (samples, 4) w x y z at the times ``wanted``: between two steps a chord is shorter than either."""
    chord = _sampled(wanted, time, dt_s, quaternion)
    return np.asarray(chord / np.linalg.norm(chord, axis=1, keepdims=True))


def _held(wanted: np.ndarray, time: np.ndarray, dt_s: float, values: np.ndarray) -> np.ndarray:
    """Return the rows of ``values`` (steps, n) at the last of ``time`` that is not after each ``wanted``.

    A pressure that follows its command at once jumps with it; between two grid points around a stamp it would seem to
    know the command that comes next.
    """
    place = np.floor((wanted - time[0]) / dt_s + 1e-9).astype(int)
    return np.asarray(values[np.clip(place, 0, len(values) - 1)])


@nb.njit(cache=True, nogil=True)
def _interpolated(place: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the rows of ``values`` (steps, n) at the fractional row numbers ``place``."""
    found = np.empty((len(place), values.shape[1]))
    for k in range(len(place)):
        left = min(max(int(np.floor(place[k] + 1e-9)), 0), len(values) - 2)
        share = min(max(place[k] - left, 0.0), 1.0)
        for i in range(values.shape[1]):
            found[k, i] = (1.0 - share) * values[left, i] + share * values[left + 1, i]
    return found
