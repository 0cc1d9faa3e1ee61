"""How loud the noise of one sample is, and what a coarse sensor's last digit adds to it."""

from collections.abc import Sequence
from math import comb

import numpy as np

from softrl.recordings.check import DataCheck, resolution
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

TELLING = 8  # rows of a run, from which on it tells what is noise
FEW_READINGS = 20  # a sensor that reports fewer values than this tells no noise by their differences


def floor_of(found: DataCheck, usable: Sequence[Recording], robot: Robot, channel: str) -> tuple[float, float]:
    """Return the noise of one sample of a channel, rms over all its components, and how much of it is rounding; m or Pa.

    Noise is told by holds or by neighbouring samples, whichever is less, or by repeats. A sensor whose last digit is coarser
    than that rounds: neighbouring samples are then wrong by the same, and no mean gets rid of it. Otherwise noise blurs the
    rounding, which is told as 0.
    """
    series = [_columns(run, channel) for run in usable if getattr(run, channel) is not None]
    series = [values for values in series if len(values) >= TELLING] or series
    if not series:
        return 0.0, 0.0
    quick = float(np.median([jitter(_readings(values)) for values in series]))
    noise = max(min(quick, found.noise_floor[channel]), found.repeatability.get(channel, 0.0))
    digit = float(np.median([np.sqrt(np.mean(resolution(values) ** 2)) for values in series]))
    rounding, whole = digit / np.sqrt(12.0), _of_all(robot, channel)
    return whole * max(noise, rounding), whole * rounding if rounding > noise else 0.0


def _columns(run: Recording, channel: str) -> np.ndarray:
    return np.asarray(getattr(run, channel)).reshape(len(run.time), -1)


def _of_all(robot: Robot, channel: str) -> float:
    """Return what makes of one component's noise that of all, of an angle in m."""
    if channel == "bend_angle":
        return robot.length_m
    return float(np.sqrt(3.0 if channel == "position" else robot.chambers))


def _readings(values: np.ndarray) -> np.ndarray:
    """Return the rows (readings, n) of ``values`` (steps, n) that do not repeat the one before: a slower sensor's own."""
    own = values[np.r_[True, np.any(np.diff(values, axis=0) != 0.0, axis=1)]]
    return own if len(own) >= FEW_READINGS else values


def jitter(values: np.ndarray) -> float:
    """Return the standard deviation of the white part of ``values`` (steps, n), from differences of high order.

    Notes
    -----
    A difference of order k has ``binom(2 k, k)`` times the variance of white noise, and the less of a smooth motion
    the higher k is; the median of its square is 0.4549 of the mean. The smallest estimate of orders 2 to 6 is taken.
    """
    found = []
    for order in range(2, 7):
        change = np.diff(values, n=order, axis=0) ** 2 / comb(2 * order, order)
        found.append(np.mean(np.median(change, axis=0)) / 0.4549)
    return float(np.sqrt(min(found)))
