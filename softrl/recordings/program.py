"""Pressure programs that tell effects apart, and the loop that records a robot under one.

A program is a pair (time (steps,) s, pressure (steps, chambers) Pa): each row is held until its time. Every
program stays within the robot's limits of pressure and slew.
"""

import logging
from collections.abc import Sequence

import numpy as np

from softrl.core.driver import Driver, Sample
from softrl.core.errors import ConfigError, DriverError
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
Program = tuple[np.ndarray, np.ndarray]
LEAST_SHARE = 0.5  # of the samples in which a channel is measured, or it is left out rather than all the others


def steps_and_holds(robot: Robot, levels: np.ndarray, hold_s: float, dt_s: float) -> Program:
    """Return one step to each row of ``levels`` (holds, chambers) Pa, held for ``hold_s``."""
    levels = np.atleast_2d(np.asarray(levels, dtype=float))
    return _program(robot, np.repeat(levels, max(round(hold_s / dt_s), 1), axis=0), dt_s)


def random_steps(robot: Robot, count: int, hold_s: float, dt_s: float, rng: np.random.Generator) -> Program:
    """Return ``count`` holds at pressures drawn uniformly within the limits, first and last at rest."""
    levels = rng.uniform(robot.pressure_min_pa, robot.pressure_max_pa, (count, robot.chambers))
    levels[0] = levels[-1] = 0.0
    return steps_and_holds(robot, levels, hold_s, dt_s)


def multisine(
    robot: Robot,
    duration_s: float,
    band_hz: tuple[float, float],
    share: float,
    dt_s: float,
    rng: np.random.Generator,
) -> Program:
    """Return tones spread over ``band_hz`` with random phases, in ``share`` of the pressure range, from rest.

    Chambers take turns on the harmonics of ``1 / duration_s``, so that each line in a spectrum belongs to one
    chamber.
    """
    _require_share(share)
    time = dt_s * np.arange(1, round(duration_s / dt_s) + 1)
    lines = np.unique(np.round(np.geomspace(*band_hz, 8 * robot.chambers) * duration_s).clip(1).astype(int))
    middle = 0.5 * (robot.pressure_max_pa + robot.pressure_min_pa)
    half = 0.5 * share * (robot.pressure_max_pa - robot.pressure_min_pa)
    pressure = np.zeros((len(time), robot.chambers))
    for i in range(robot.chambers):
        mine = lines[i :: robot.chambers] if len(lines[i :: robot.chambers]) else lines
        phase = rng.uniform(0.0, 2.0 * np.pi, len(mine))
        tones = np.sin(2.0 * np.pi * np.outer(time, mine) / duration_s + phase).sum(axis=1)
        pressure[:, i] = middle + half * tones / np.abs(tones).max()
    return _program(robot, pressure * np.minimum(time / min(2.0, 0.1 * duration_s), 1.0)[:, None], dt_s)


def triangles(
    robot: Robot, chamber: int, peak_pa: float, periods_s: Sequence[float], cycles: int, dt_s: float
) -> Program:
    """Return ``cycles`` triangles of one chamber at each period: the same path at several rates.

    A loop whose width stays when the rate falls is rate-independent hysteresis; one that changes is viscosity
    or lag.
    """
    waves = [np.tile(_triangle(round(period / dt_s)), cycles) for period in periods_s]
    return _program(robot, _one_chamber(robot, chamber, peak_pa * np.concatenate(waves)), dt_s)


def staircase(robot: Robot, chamber: int, levels: int, repeats: int, period_s: float, dt_s: float) -> Program:
    """Return one chamber's triangles of rising maxima, in size, each repeated: softening shows after a new maximum."""
    peaks = np.repeat(np.arange(1, levels + 1) / levels, repeats) * farthest_pa(robot)
    wave = _triangle(round(period_s / dt_s))
    return _program(robot, _one_chamber(robot, chamber, (peaks[:, None] * wave).ravel()), dt_s)


def farthest_pa(robot: Robot) -> float:
    """Return the limit that is farther from rest, Pa: where both are as far that above the room's pressure."""
    return max(robot.pressure_max_pa, robot.pressure_min_pa, key=abs)


def limited(robot: Robot, pressure: np.ndarray, dt_s: float) -> np.ndarray:
    """Return ``pressure`` (steps, chambers) Pa within the robot's limits and slew, starting from 0 Pa or the limit next to it."""
    wanted = np.clip(pressure, robot.pressure_min_pa, robot.pressure_max_pa)
    reach = robot.slew_pa_per_s * dt_s
    rest = np.clip(0.0, robot.pressure_min_pa, robot.pressure_max_pa)
    sent, last = np.empty_like(wanted), np.full(wanted.shape[1], rest)
    for k, row in enumerate(wanted):
        last = last + np.clip(row - last, -reach, reach)
        sent[k] = last
    return sent


def record(driver: Driver, robot: Robot, time: np.ndarray, pressure: np.ndarray, name: str, session: str) -> Recording:
    """Return what a connected ``driver`` reports while it runs a program, on the device's own clock.

    Parameters
    ----------
    driver : entered already, so that several programs can follow each other in one session
    robot : named in messages
    time, pressure : (steps,) s uniform, (steps, chambers) Pa
    name, session : of the recording

    Raises
    ------
    DriverError
        If fewer than two samples arrived.
    """
    dt_s = float(time[1] - time[0])
    samples: list[Sample] = []
    for row in pressure:
        driver.command(row)
        samples.extend(driver.advance(dt_s))
    return recording_of(samples, robot, name, session)


def recording_of(samples: Sequence[Sample], robot: Robot, name: str, session: str) -> Recording:
    """Return the samples that a driver delivered during one run as a recording.

    A channel that the device does not measure, or seldom does, is None; a sample that lacks a value of another channel, as
    where the camera lost the tip for a moment, is left out.

    Raises
    ------
    DriverError
        If fewer than two samples arrived, or have values in all channels.
    """
    if len(samples) < 2:
        raise DriverError(f"run {name} of {robot.name}: {len(samples)} samples arrived; is the link up?")
    commanded = np.stack([s.commanded for s in samples])
    measured = {
        "position": np.stack([s.position for s in samples]),
        "pressure_meas": np.stack([s.pressure for s in samples]),
        "quaternion": np.stack([s.quaternion for s in samples]),
        "tip_force": np.stack([s.tip_force for s in samples]),
    }
    channels, whole = _measured(measured, np.isfinite(commanded).all(axis=1), name)
    if whole.sum() < 2:
        raise DriverError(
            f"run {name} of {robot.name}: {whole.sum()} of {len(samples)} samples have values in all channels; expected 2 "
            "or more: does the device report what it commands, and does the camera see the tip?"
        )
    return Recording(
        name=name,
        session=session,
        time=np.array([s.time_s for s in samples])[whole],
        pressure_cmd=commanded[whole],
        **{channel: values[whole] for channel, values in channels.items()},
    )


def _measured(
    channels: dict[str, np.ndarray], commanded: np.ndarray, run: str
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the ``channels`` (samples, n) that are measured, and which of the samples (samples,) have values in all.

    ``commanded`` (samples,) are those of which the command is known.
    """
    kept, whole = {}, commanded.copy()
    for channel, values in channels.items():
        known = np.isfinite(values).all(axis=1)
        if not known.any():
            continue
        # without a position a sample tells nothing of the motion, however few of them have one
        if channel != "position" and (known & whole).sum() < LEAST_SHARE * whole.sum():
            log.warning(
                "run %s: %s is measured in %d of %d samples and is left out", run, channel, known.sum(), len(known)
            )
            continue
        kept[channel] = values
        whole &= known
    if not whole.all():
        log.warning("run %s: %d of %d samples lack a reading and are left out", run, (~whole).sum(), len(whole))
    return kept, whole


def _program(robot: Robot, pressure: np.ndarray, dt_s: float) -> Program:
    return dt_s * np.arange(1, len(pressure) + 1), limited(robot, pressure, dt_s)


def _triangle(steps: int) -> np.ndarray:
    """Return one triangle from 0 over 1 back to 0 in ``steps`` samples."""
    phase = np.arange(1, steps + 1) / steps
    return 1.0 - np.abs(2.0 * phase - 1.0)


def _one_chamber(robot: Robot, chamber: int, wave: np.ndarray) -> np.ndarray:
    if not 0 <= chamber < robot.chambers:
        raise ConfigError(f"chamber={chamber} does not exist; robot {robot.name} has chambers 0..{robot.chambers - 1}")
    pressure = np.zeros((len(wave), robot.chambers))
    pressure[:, chamber] = wave
    return pressure


def _require_share(share: float) -> None:
    if not 0.0 < share <= 1.0:
        raise ConfigError(f"share={share:g} of the pressure range must lie in 0..1")
