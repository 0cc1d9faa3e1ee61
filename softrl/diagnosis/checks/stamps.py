"""Stamps that jitter about an even clock: whether rows came when they say, or evenly, as the motion itself tells.

What writes a row down notes the time when it gets round to it; a camera has taken the picture by its own clock. A tip at 0.3 m/s
is 0.6 mm elsewhere 2 ms later, more than most of what is missing from a simulator.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from softrl.diagnosis.checks.spikes import ALONE
from softrl.recordings.recording import Recording

OFF = 0.4  # of the period: a stamp farther from its tick is off the clock
ON_CLOCK = 0.98  # of the stamps that have to be on it
LEAST = 0.01  # of the period: less jitter is that of digits
PULL = 0.05  # of how far a stamp is from its tick, by which the next ticks move
AROUND = 51  # rows over which the clock may wander
WANDERS = 0.3  # times the jitter: a mean over so many rows differs by half of that without any wandering
SLOPE = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0
WILD = 6.0  # times the median of what samples are off their neighbours: a jump, or a slip of the tracking
REPEATED = 0.1  # of the samples: more show a sensor slower than the rows, whose values jump
SURE = 3.0  # standard errors
KEPT = 0.5  # of the jitter: where the motion may show as much, the stamps are right
FEWEST = 5  # pieces in which the rows are looked at: the error is that of their mean


class _Seen(NamedTuple):
    """How far samples are off their neighbours (k,), and how far they would be by their stamps (k,), both m or rad."""

    off: np.ndarray
    told: np.ndarray


def evened(runs: Sequence[Recording]) -> tuple[tuple[Recording, ...], list[str]]:
    """Return ``runs`` with even times where the motion shows that rows come evenly and only their stamps jitter, and so in words.

    A sample is compared with the middle of its neighbours': if the row came late, it has gone farther by as much as the motion
    is fast. The share of the stamps' jitter that the motion shows, 1 where they are right and 0 where they are not, is that of
    all runs together: they are of one log. Nothing changes unless it is below ``KEPT`` for sure.
    """
    clocks = [even_clock(run.time) for run in runs]
    pieces = [
        piece
        for run, even in zip(runs, clocks, strict=True)
        if even is not None
        for values in (run.position, run.bend_angle)
        if values is not None
        for piece in _pieces(run, even, values.reshape(len(values), -1))
    ]
    share, error = _share_of(pieces)
    if not share + SURE * error < KEPT:
        return tuple(runs), []
    shift = [None if even is None else even - run.time for run, even in zip(runs, clocks, strict=True)]
    jitter = np.concatenate([by for by in shift if by is not None]).std()
    told = (
        f"the rows' times jitter by {1e3 * jitter:.2g} ms (rms) about an even clock, and the motion shows {share:.0%} of that "
        f"(within {SURE * error:.0%}): rows are taken to come evenly"
    )
    return tuple(run if by is None else replace(run, time=run.time + by) for run, by in zip(runs, shift, strict=True)), [told]


def even_clock(time: np.ndarray) -> np.ndarray | None:
    """Return the times (steps,) s of a clock's ticks about which the stamps ``time`` (steps,) jitter; None if there is none."""
    apart = np.diff(time)
    if len(apart) < AROUND or np.median(apart) <= 0.0:
        return None
    count = _ticks(time, float(np.median(apart)))
    count = _ticks(time, float(np.polyfit(count, time, 1)[0]))
    period, first = np.polyfit(count, time, 1)
    even = period * count + first
    wander = uniform_filter1d(median_filter(time - even, AROUND, mode="nearest"), AROUND, mode="nearest")
    if wander.std() > WANDERS * (time - even - wander).std():
        even = even + wander
    off = np.abs(time - even)
    on_clock = np.mean(off < OFF * period) >= ON_CLOCK and np.sqrt(np.mean(off**2)) > LEAST * period
    return even if on_clock and (np.diff(even) > 0.0).all() else None


def _ticks(time: np.ndarray, period: float) -> np.ndarray:
    """Return the number (steps,) of the tick at which each row was taken, of a clock that the stamps pull along."""
    count, tick = np.zeros(len(time)), float(np.median(time[:FEWEST] - period * np.arange(FEWEST)))
    for k in range(1, len(time)):
        cycles = max(round((time[k] - tick) / period), 1)
        tick += cycles * period
        tick += PULL * (time[k] - tick)
        count[k] = count[k - 1] + cycles
    return count


def _pieces(run: Recording, even: np.ndarray, values: np.ndarray) -> list[_Seen]:
    """Return what the samples ``values`` (steps, n) with two neighbours on each side show, in pieces of equal length."""
    moved = (np.diff(values, axis=0) != 0.0).any(axis=1)
    if np.mean(~moved) > REPEATED:
        return []
    steps = np.diff(even)
    near = (np.abs(steps - np.median(steps)) < OFF * np.median(steps)) & run.seen[1:] & run.seen[:-1]
    rows = np.flatnonzero(np.convolve(near, np.ones(4), "valid") > 3.5)[:, None] + np.arange(5)
    if len(rows) < AROUND:
        return []
    off = np.einsum("j,kjn->kn", ALONE, values[rows])
    speed = np.einsum("j,kjn->kn", SLOPE, values[rows]) / np.median(steps)
    told = speed * ((run.time - even)[rows] @ ALONE)[:, None]
    tame = np.abs(off) < WILD * np.median(np.abs(off), axis=0)
    parts = [np.array_split(found, FEWEST) for found in (off, told, tame)]
    return [_Seen(a[good], b[good]) for a, b, good in zip(*parts, strict=True)]


def _share_of(pieces: Sequence[_Seen]) -> tuple[float, float]:
    """Return the share of the jitter that the motion shows, and its standard error by leaving out every piece in turn."""
    across = np.array([piece.told @ piece.off for piece in pieces])
    square = np.array([piece.told @ piece.told for piece in pieces])
    if len(pieces) < FEWEST or not square.sum() > 0.0:
        return 1.0, np.inf
    without = (across.sum() - across) / np.maximum(square.sum() - square, 1e-300)
    spread = np.sqrt((len(pieces) - 1) / len(pieces) * np.sum((without - without.mean()) ** 2))
    return float(across.sum() / square.sum()), float(spread)
