"""How loud the noise of one sample is, and what a coarse sensor's last digit adds to it."""

from collections.abc import Sequence
from math import comb

import numpy as np

from softrl.recordings.check import DataCheck, resolution
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

TELLING = 8  # rows of a run, from which on it tells what is noise
LOUD = 0.1  # of the motion, above which noise is asked for beside what commands foretell
PAST, RIDGE = 3, 1e-4  # rows of commands that foretell the motion; share of the mean square by which that is regularised
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
    if noise > LOUD * float(np.median([np.sqrt(np.mean(values.var(axis=0))) for values in series])):
        noise = min(noise, _left_by_commands([run for run in usable if getattr(run, channel) is not None], channel))
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


def _left_by_commands(runs: Sequence[Recording], channel: str) -> float:
    """Return the rms that the commands of the last rows, and their squares and products, leave in runs left out in turn.

    Where every row is another pose, what neighbouring rows differ by is motion. Noise is what no command foretells.
    """
    rows = [_foretelling(run.pressure_cmd) for run in runs]
    seen = [_columns(run, channel) - _columns(run, channel).mean(axis=0) for run in runs]
    grams = [(x.T @ x, x.T @ y) for x, y in zip(rows, seen, strict=True)]
    total, cross = sum(gram for gram, _ in grams), sum(along for _, along in grams)
    left, count = 0.0, 0
    for x, y, (gram, along) in zip(rows, seen, grams, strict=True):
        others = total - gram
        share = RIDGE * np.diag(np.diag(total)) + 1e-12 * np.trace(total) * np.eye(len(total))
        left += float(np.sum((y - x @ np.linalg.solve(others + share, cross - along)) ** 2))
        count += y.size
    return float(np.sqrt(left / count))


def _foretelling(command: np.ndarray) -> np.ndarray:
    """Return commands (steps, chambers) of a row and of those before, with squares and products, less their means: (steps, m)."""
    past = [np.r_[np.repeat(command[:1], k, axis=0), command[: len(command) - k]] for k in range(PAST)]
    first, second = np.triu_indices(command.shape[1])
    columns = np.hstack([np.hstack([rows, rows[:, first] * rows[:, second]]) for rows in past])
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
