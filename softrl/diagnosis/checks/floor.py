"""How loud the noise of one sample is, and what a coarse sensor's last digit adds to it."""

from collections.abc import Sequence
from math import comb
from typing import NamedTuple

import numpy as np

from softrl.diagnosis.checks.gaps import rows
from softrl.recordings.check import DataCheck, resolution
from softrl.recordings.lost import MOTION
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

TELLING, LEAST = 8, 3  # rows of a run, from which on it tells what is noise, and without which it tells nothing of it
LOUD = 0.1  # of the motion, above which noise is asked for beside what commands foretell
PAST, RIDGE = 3, 1e-6  # rows of commands that foretell a row; share of a column's square by which that is regularised
FEW_READINGS = 20  # a sensor that reports fewer values than this tells no noise by their differences


class Floor(NamedTuple):
    """The noise of one sample of a channel, rms over all its components; m or Pa, of an orientation rad.

    Attributes
    ----------
    noise : all of it
    rounding : by a sensor whose last digit is coarser than its noise: neighbouring samples are then wrong by the same, and no
        mean gets rid of it. Otherwise noise blurs the rounding, which is told as 0
    at_most : whether it may be less: rows were too slow to tell it from motion
    """

    noise: float
    rounding: float
    at_most: bool = False


def floor_of(found: DataCheck, usable: Sequence[Recording], robot: Robot, channel: str) -> Floor:
    """Return the noise of a channel, as holds or neighbouring samples tell it, whichever is less, or repeats."""
    if channel in MOTION:
        usable = [rows(run, run.seen) for run in usable]
    series = [_columns(run, channel) for run in usable if getattr(run, channel) is not None]
    series = [values for values in series if len(values) >= TELLING] or [values for values in series if len(values) >= LEAST]
    if not series:
        return Floor(0.0, 0.0)
    quick = float(np.median([jitter(_readings(values)) for values in series]))
    noise = max(min(quick, found.noise_floor[channel]), found.repeatability.get(channel, 0.0))
    loud = noise > LOUD * float(np.median([np.sqrt(np.mean(values.var(axis=0))) for values in series]))
    if loud:
        noise = min(noise, _left_by_commands([run for run in usable if getattr(run, channel) is not None], channel))
    digit = float(np.median([np.sqrt(np.mean(resolution(values) ** 2)) for values in series]))
    rounding, whole = digit / np.sqrt(12.0), _of_all(robot, channel)
    return Floor(whole * max(noise, rounding), whole * rounding if rounding > noise else 0.0, loud and noise > rounding)


def _columns(run: Recording, channel: str) -> np.ndarray:
    return np.asarray(getattr(run, channel)).reshape(len(run.time), -1)


def _of_all(robot: Robot, channel: str) -> float:
    """Return what makes of one component's noise that of all, of an angle in m, of a quaternion that of the turn in rad."""
    if channel == "bend_angle":
        return robot.length_m
    if channel == "quaternion":
        return 4.0  # a turn is twice as large as what it changes of the four numbers together
    return float(np.sqrt(3.0 if channel == "position" else robot.chambers))


def _readings(values: np.ndarray) -> np.ndarray:
    """Return the rows (readings, n) of ``values`` (steps, n) that do not repeat the one before: a slower sensor's own."""
    own = values[np.r_[True, np.any(np.diff(values, axis=0) != 0.0, axis=1)]]
    return own if len(own) >= FEW_READINGS else values


def _left_by_commands(runs: Sequence[Recording], channel: str) -> float:
    """Return the rms that commands and the row before leave in runs left out in turn; infinite of a single run.

    Where every row is another pose, what neighbouring rows differ by is motion. Noise is what nothing foretells.
    """
    if len(runs) < 2:
        return np.inf
    seen = [_columns(run, channel) for run in runs]
    gauge = channel == "pressure_meas"
    rows = [_foretelling(run.pressure_cmd, values, gauge) for run, values in zip(runs, seen, strict=True)]
    seen = [values[1:] - values[1:].mean(axis=0) for values in seen]
    size = np.sqrt(sum(np.sum(x**2, axis=0) for x in rows))
    rows = [x / np.maximum(size, 1e-300) for x in rows]
    grams = [(x.T @ x + RIDGE / len(rows) * np.eye(len(size)), x.T @ y) for x, y in zip(rows, seen, strict=True)]
    total, cross = sum(gram for gram, _ in grams), sum(along for _, along in grams)
    squares = [
        np.sum((y - x @ np.linalg.solve(total - gram, cross - along)) ** 2)
        for x, y, (gram, along) in zip(rows, seen, grams, strict=True)
    ]
    return float(np.sqrt(sum(squares) / sum(y.size for y in seen)))


def _foretelling(command: np.ndarray, seen: np.ndarray, gauge: bool) -> np.ndarray:
    """Return what may foretell the rows of a run but the first, less its mean, (steps - 1, m).

    The commands (steps, chambers) of a row and of those before, their squares and products, what was ``seen`` (steps, n) in the
    row before, and of a ``gauge`` how far below either command it was then: filling and venting take their own times.
    """
    past = [np.r_[np.repeat(command[:1], k, axis=0), command[: len(command) - k]][1:] for k in range(PAST)]
    first, second = np.triu_indices(command.shape[1])
    below = [np.maximum(rows - seen[:-1], 0.0) for rows in past[:2] if gauge]
    columns = np.hstack([seen[:-1], *below, *past, *(rows[:, first] * rows[:, second] for rows in past)])
    return np.asarray(columns - columns.mean(axis=0))


def jitter(values: np.ndarray) -> float:
    """Return the standard deviation of the white part of ``values`` (steps, n), from differences of high order.

    Notes
    -----
    A difference of order k has ``binom(2 k, k)`` times the variance of white noise, and the less of a smooth motion
    the higher k is; the median of its square is 0.4549 of the mean. The smallest estimate of orders 2 to 6 is taken.
    """
    found = []
    for order in range(2, min(7, len(values))):
        change = np.diff(values, n=order, axis=0) ** 2 / comb(2 * order, order)
        found.append(np.mean(np.median(change, axis=0)) / 0.4549)
    return float(np.sqrt(min(found)))
