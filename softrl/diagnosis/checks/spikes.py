"""Single wrong samples of the motion: a marker mistaken for another, a detection that failed for an instant."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import correlate1d, median_filter, percentile_filter

from softrl.core.identity import Same
from softrl.diagnosis.checks.strayed import DIGITS, strayed
from softrl.effects.hold import reading_period, reading_phase
from softrl.recordings.check import resolution
from softrl.recordings.lost import lost
from softrl.recordings.recording import Recording

LONGEST = 7  # samples: what lasts longer may be real
TIMES = 10.0  # a spike stands out from the running median by this many times what four samples out of five do
LEAST_SHARE = 0.02  # of the range
NEARBY, CALM_PERCENT = 1.5, 85.0  # times what so many of the samples around it do: a fast swing has many peaks
COMMAND_SHARE, JUST = 0.15, 3  # of its range: a command that changes by more within a row jumps; rows for which that counts
ALONE = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 6.0  # how far a sample is off a cubic through its neighbours, and puts these off
CLEAR, NOT_ALONE = 4.0, 0.2  # times what samples nearby are off; of its pattern, that may be left without it
JUMP_SHARE = 0.5  # of its height a spike is entered and left by within one sample, beyond the motion before and after


def without_spikes(runs: Sequence[Recording]) -> tuple[tuple[Recording, ...], list[str]]:
    """Return the runs with spikes of the motion marked as unseen, and how many there were, a sentence a run.

    What was commanded meanwhile stays.
    """
    kept, lines = [], []
    for run in runs:
        wrong = np.zeros(len(run.time), dtype=bool)
        for values in (run.position, run.bend_angle):
            if values is not None:
                seen = values.reshape(len(values), -1)
                first, reading = _readings(run, seen)
                wrong |= spikes(seen[first], np.hstack([run.pressure_cmd, *_pushes(run)])[first])[reading]
                if len(first) == len(seen):  # the few readings of a slow sensor all jump
                    wrong |= strayed(run.time, seen, _causes(run))
        if wrong.any():
            lines.append(
                f"{run.name}: {np.count_nonzero(wrong)} samples, first at t = {run.time[wrong][0]:.2f} s, jump away and "
                "back at once or within seconds and are left out: the tracking mistook something"
            )
        kept.append(lost(run, wrong) if wrong.any() else run)
    return tuple(kept), lines


def _causes(run: Recording) -> np.ndarray:
    """Return all pressures and pushes (steps, m) of ``run`` side by side."""
    gauges = [] if run.pressure_meas is None else [run.pressure_meas]
    return np.hstack([run.pressure_cmd, *gauges, *_pushes(run)])


def _pushes(run: Recording) -> list[np.ndarray]:
    """Return the force (steps, 3) N on the tip with its jumps alone, if one was measured: its noise throws nothing."""
    if run.tip_force is None or len(run.time) < 2:
        return []
    step = np.diff(run.tip_force, axis=0, prepend=run.tip_force[:1])
    size = np.abs(step)
    jumps = size > np.maximum(COMMAND_SHARE * np.ptp(run.tip_force, axis=0), TIMES * np.median(size, axis=0))
    return [np.cumsum(np.where(jumps, step, 0.0), axis=0)]


def _readings(run: Recording, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first sample (readings,) of every reading of a slow sensor, and the reading (steps,) of every sample.

    A sensor that repeats its last value moves by jumps, at the turn of a motion away and back. Where none repeats, every
    sample is a reading.
    """
    count, period = np.arange(len(run.time), dtype=float), reading_period([(run.time, values)])
    if period is not None:
        phase = reading_phase(Same(run), period).latest_s
        count = np.floor((run.time - run.time[0] - phase) / period + 1e-6)
    _, first, reading = np.unique(count, return_index=True, return_inverse=True)
    return first, reading


def spikes(values: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return which rows (steps,) of ``values`` (steps, n) lie on a spike of at most ``LONGEST`` samples.

    Not where one of the ``commands`` (steps, m), or of the pushes, has just jumped: two steps that follow each other throw the
    tip there and back.
    """
    wrong = np.zeros(len(values), dtype=bool)
    if len(values) <= 2 * LONGEST + 1:
        return wrong
    off = values - median_filter(values, size=(2 * LONGEST + 1, 1), mode="nearest")
    height = np.linalg.norm(off, axis=1)
    span, digit = (float(np.linalg.norm(size)) for size in (np.ptp(values, axis=0), resolution(values)))
    level = max(TIMES * float(np.quantile(height, 0.8)), LEAST_SHARE * span, DIGITS * digit)
    nearby = percentile_filter(height, CALM_PERCENT, size=8 * LONGEST + 1, mode="nearest")
    thrown = _just_jumped(commands)
    edges = np.flatnonzero(np.diff(np.r_[False, height > level, False].astype(int)))
    for first, end in edges.reshape(-1, 2):
        if first == 0 or end == len(values) or end - first > LONGEST or thrown[first:end].any():
            continue
        if height[first:end].max() < NEARBY * nearby[(first + end) // 2]:
            continue
        jump = JUMP_SHARE * float(height[first:end].max())
        entered, left = _aside(values, first, -1), _aside(values, end - 1, 1)
        if min(np.linalg.norm(entered), np.linalg.norm(left)) > jump and entered @ left > 0.0:
            wrong[first:end] = True
    return wrong | (_lone(values, max(LEAST_SHARE * span, DIGITS * digit)) & ~thrown)


def _lone(values: np.ndarray, least: float) -> np.ndarray:
    """Return which rows (steps,) of ``values`` (steps, n) are wrong alone, by ``least`` or more, however fast all moves.

    Such a sample is off a cubic through its neighbours, and puts these off theirs by shares that it alone leaves.
    """
    wrong, reach = np.zeros(len(values), dtype=bool), len(ALONE) // 2
    off = correlate1d(values, ALONE, axis=0, mode="nearest")
    size = correlate1d(off, ALONE, axis=0, mode="nearest") / (ALONE @ ALONE)
    height, level = (np.linalg.norm(rows, axis=1) for rows in (size, off))
    level = percentile_filter(level, CALM_PERCENT, size=8 * LONGEST + 1, mode="nearest")
    for row in np.flatnonzero(height > np.maximum(CLEAR * level, least)):
        around = slice(row - reach, row + reach + 1)
        if not 2 * reach <= row < len(values) - 2 * reach or height[row] < height[around].max():
            continue
        rest = off[around] - np.outer(ALONE, size[row])
        wrong[row] = np.linalg.norm(rest) < NOT_ALONE * height[row] * np.linalg.norm(ALONE)
    return wrong


def _just_jumped(commands: np.ndarray) -> np.ndarray:
    """Return where (steps,) a command has jumped within the last ``JUST`` rows."""
    span = np.maximum(np.ptp(commands, axis=0), 1e-300)
    jumped = (np.abs(np.diff(commands, axis=0, prepend=commands[:1])) > COMMAND_SHARE * span).any(axis=1)
    return np.convolve(jumped, np.ones(JUST + 1), mode="full")[: len(jumped)] > 0.0


def _aside(values: np.ndarray, row: int, towards: int) -> np.ndarray:
    """Return how far ``values[row]`` (n,) lies off the straight line through the two rows next to it on one side.

    A body that moves fast and turns round goes on as it went before, a mistaken sample does not.
    """
    near, far = row + towards, row + 2 * towards
    far = far if 0 <= far < len(values) else near
    return np.asarray(values[row] - 2.0 * values[near] + values[far])
