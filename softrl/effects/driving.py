"""What drives a recording on a uniform grid: its commands as they were held, or its measured pressures as they changed."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrl.core.errors import RecordingError
from softrl.core.span import Span, after, held
from softrl.effects.chain import EffectChain
from softrl.recordings.recording import Recording
from softrl.recordings.rhythm import SLOWER, periods

MAX_STEPS = 5_000_000
NEARER = 0.999  # of what a pressure lacked of its command a sample before: if it lacks more, it changes as good as evenly
ROUNDING, SMALLEST = 1e-6, 1e-300  # share of that which may be rounding, and one that is none
LOST_PERIODS, LOST_S = SLOWER, 2.0  # periods, s: a pause between these is of rows that were lost, not of a log that waits


class Supply(NamedTuple):
    """A valve that is understood: its effects, how late rows act there, s, and what is measured beyond what it does.

    ``apart`` (samples, chambers) Pa, which changes evenly between samples.
    """

    chain: EffectChain
    late_s: float
    apart: np.ndarray


def drive_on_grid(
    recording: Recording,
    dt_s: float,
    drive: str,
    settle_s: float,
    late_s: float = 0.0,
    supply: Supply | None = None,
    later: np.ndarray | None = None,
) -> tuple[np.ndarray, Span, Span | None]:
    """Return the uniform grid (steps,) s, the pressures (steps, chambers) Pa and forces (steps, 3) N on it.

    Commands act ``later`` (samples,) s than all rows do.
    """
    time, first = _grid(recording, dt_s, settle_s)
    stamps, rows = recording.time + late_s, _driving(recording, drive)
    if later is not None and drive == "command":
        stamps = np.maximum.accumulate(stamps + later)
    if drive == "measured" and supply is not None:
        _, command, _ = drive_on_grid(recording, dt_s, "command", settle_s, late_s + supply.late_s, later=later)
        valve = replace(supply.chain, effects=supply.chain.at("valve"), before_s=settle_s + dt_s)
        if first and recording.pressure_meas is not None:
            stood = valve.stood_under(command.mean[0], recording.pressure_meas[0] - supply.apart[0], first, dt_s)
            command = after(np.tile(stood, (first, 1)), command)
        made, apart = valve.supplied(command, dt_s), _changing(stamps, supply.apart, time, dt_s)
        pressure = Span(made.mean + apart.mean, made.end + apart.end)
    elif drive == "measured":
        pressure = _changing(stamps, rows, time, dt_s, recording.pressure_cmd)
    else:
        pressure = held(_mean_held(*_bridged(stamps, rows), time, dt_s))
    if first and drive == "measured" and recording.pressure_meas is not None:
        pressure = after(np.tile(recording.pressure_meas[0], (first, 1)), pressure)
    return time, pressure, _force(recording, time, dt_s, late_s if drive == "measured" else 0.0)


def _force(recording: Recording, time: np.ndarray, dt_s: float, late_s: float) -> Span | None:
    """Return the forces (steps, 3) N on the grid, measured at their rows' times: how late commands act is nothing to them."""
    if recording.tip_force is None:
        return None
    return _changing(recording.time + late_s, recording.tip_force, time, dt_s)


def _bridged(stamps: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return samples (samples,), (samples, n) with those that a log has lost, taken to change evenly.

    A command is held until its time: the first one after a pause would act from before it.
    """
    apart = np.diff(stamps)
    period = periods(apart)
    lost = np.flatnonzero((apart > LOST_PERIODS * period) & (apart <= LOST_S))
    if not len(lost):
        return stamps, rows
    between = [np.arange(stamps[k] + period[k], stamps[k + 1] - 0.5 * period[k], period[k]) for k in lost]
    added = np.concatenate(between)
    places = np.searchsorted(stamps, added)  # stamps stay as they are: rows that come at one time are each their own
    return np.insert(stamps, places, added), np.insert(rows, places, evenly(added, stamps, rows), axis=0)


def evenly(at: np.ndarray, time: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return ``rows`` (samples, n), which change evenly between their times (samples,), at the times ``at`` (steps,)."""
    return np.stack([np.interp(at, time, column) for column in rows.T], axis=1)


def _changing(
    stamps: np.ndarray, rows: np.ndarray, time: np.ndarray, dt_s: float, goal: np.ndarray | None = None
) -> Span:
    """Return ``rows`` (samples, n), which change between their stamps, over each step (time - dt, time] and at its end.

    They change evenly, but for those that have come nearer to their ``goal`` (samples, n), the command until then, ever since
    that changed: what makes for it with a lag does so quickly at first. A command is held, but a measured pressure that was held
    until the next sample would be early by up to half the time to it, and late by as much if it changed evenly though it jumped.
    """
    edges = np.r_[time[0] - dt_s, time]
    knots = np.union1d(edges, stamps)
    ends = evenly(knots, stamps, rows)
    means = 0.5 * (ends[1:] + ends[:-1])
    if goal is not None:
        _bend(knots, means, ends, stamps, rows, goal)
    at_edges = np.isin(knots, edges)
    mean = np.diff(_summed(means, knots)[at_edges], axis=0) / dt_s
    return Span(np.ascontiguousarray(mean), ends[at_edges][1:])


def _bend(
    knots: np.ndarray, means: np.ndarray, ends: np.ndarray, stamps: np.ndarray, rows: np.ndarray, goal: np.ndarray
) -> None:
    """Replace ``means`` (knots - 1, n) and ``ends`` (knots, n) where rows have come nearer to their ``goal`` since it changed.

    What is left of the way falls exponentially from row to row there, to all precision where the next row is the goal.
    """
    way, to, span = goal[1:] - rows[:-1], goal[1:] - rows[1:], np.diff(stamps)
    left = np.divide(to, way, where=way != 0.0, out=np.ones_like(way))
    nearer = (left > -ROUNDING) & (left < NEARER)
    number = np.arange(1, len(rows))[:, None]
    changed, failed = (
        np.maximum.accumulate(np.where(which, number, 0)) for which in (goal[1:] != goal[:-1], ~nearer)
    )
    follows = changed > failed
    decay = np.log(np.where(left < ROUNDING, SMALLEST, np.minimum(left, NEARER)))
    last = np.searchsorted(stamps, knots[1:])
    inside = np.flatnonzero((last > 0) & (last < len(stamps)))
    k = last[inside] - 1
    begin, end = (np.exp(decay[k] * ((at - stamps[k]) / span[k])[:, None]) for at in (knots[inside], knots[inside + 1]))
    mean = (end - begin) / (decay[k] * ((knots[inside + 1] - knots[inside]) / span[k])[:, None])
    means[inside] = np.where(follows[k], goal[k + 1] - way[k] * mean, means[inside])
    ends[inside + 1] = np.where(follows[k], goal[k + 1] - way[k] * end, ends[inside + 1])


def _mean_held(stamps: np.ndarray, rows: np.ndarray, time: np.ndarray, dt_s: float) -> np.ndarray:
    """Return the mean over each step (time - dt, time] of ``rows`` (samples, n), each held until its stamp, the last to the end.

    A change within a step acts on the rest of the step only: taken whole, uneven stamps would make it early by half a
    step on average, which looks like a delay of the robot.
    """
    begin, end = stamps[0] - dt_s - max(stamps[0] - time[0], 0.0), max(stamps[-1], time[-1]) + dt_s
    knots = np.r_[begin, stamps, end]
    kept = np.vstack([rows, rows[-1:]])
    total = _summed(kept, knots)
    edges = np.r_[time[0] - dt_s, time]
    return np.ascontiguousarray(np.diff(evenly(edges, knots, total), axis=0) / dt_s)


def _summed(rows: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the integral (knots, n) up to each of ``knots`` (knots,) of what is ``rows`` (knots - 1, n) between them."""
    return np.vstack([np.zeros((1, rows.shape[1])), np.cumsum(rows * np.diff(knots)[:, None], axis=0)])


def _grid(recording: Recording, dt_s: float, settle_s: float) -> tuple[np.ndarray, int]:
    """Return a uniform grid that spans the samples, and how many of its rows come before the first."""
    first = round(settle_s / dt_s)
    steps = first + 1 + int(np.ceil((recording.time[-1] - recording.time[0]) / dt_s - 1e-9))
    if steps > MAX_STEPS:
        raise RecordingError(
            f"run {recording.name} lasts {np.ptp(recording.time):g} s, which is {steps} steps of {dt_s:g} s; "
            f"expected at most {MAX_STEPS}; cut the run or raise dt_s"
        )
    return recording.time[0] + dt_s * (np.arange(max(steps, 2)) - first), first


def _driving(recording: Recording, drive: str) -> np.ndarray:
    if drive == "command":
        return recording.pressure_cmd
    if drive != "measured":
        raise ValueError(f"drive={drive!r}; expected command or measured")
    if recording.pressure_meas is None:
        raise RecordingError(f"run {recording.name} has no measured pressure; replay it from its commands")
    return recording.pressure_meas
