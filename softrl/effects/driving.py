"""What drives a recording on a uniform grid: its commands as they were held, or its measured pressures as they changed."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrl.core.errors import RecordingError
from softrl.effects.chain import EffectChain
from softrl.recordings.recording import Recording
from softrl.recordings.rhythm import SLOWER, periods

MAX_STEPS = 5_000_000
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
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
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
            command[:first] = valve.stood_under(command[0], recording.pressure_meas[0] - supply.apart[0], first, dt_s)
        pressure = valve.filter(["valve"], command, dt_s) + evenly(time, stamps, supply.apart)
    else:
        known, held = _bridged(stamps, rows) if drive == "command" else _filled_in(stamps, rows, time)
        pressure = _mean_held(known, held, time, dt_s)
    if first and drive == "measured" and recording.pressure_meas is not None:
        pressure[:first] = recording.pressure_meas[0]
    return time, pressure, _force(recording, time, dt_s, late_s if drive == "measured" else 0.0)


def _force(recording: Recording, time: np.ndarray, dt_s: float, late_s: float) -> np.ndarray | None:
    """Return the forces (steps, 3) N on the grid, measured at their rows' times: how late commands act is nothing to them."""
    if recording.tip_force is None:
        return None
    return _mean_held(*_filled_in(recording.time + late_s, recording.tip_force, time), time, dt_s)


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


def _filled_in(stamps: np.ndarray, rows: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return samples (samples,), (samples, n) with further ones at the grid's times, where a pressure has changed evenly.

    A command is held, but a measured pressure that was held until the next sample would be early by half the time to it.
    """
    filled = np.union1d(stamps, time[(time > stamps[0]) & (time < stamps[-1])])
    return filled, evenly(filled, stamps, rows)


def evenly(at: np.ndarray, time: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return ``rows`` (samples, n), which change evenly between their times (samples,), at the times ``at`` (steps,)."""
    return np.stack([np.interp(at, time, column) for column in rows.T], axis=1)


def _mean_held(stamps: np.ndarray, rows: np.ndarray, time: np.ndarray, dt_s: float) -> np.ndarray:
    """Return the mean over each step (time - dt, time] of ``rows`` (samples, n), each held until its stamp, the last to the end.

    A change within a step acts on the rest of the step only: taken whole, uneven stamps would make it early by half a
    step on average, which looks like a delay of the robot.
    """
    begin, end = stamps[0] - dt_s - max(stamps[0] - time[0], 0.0), max(stamps[-1], time[-1]) + dt_s
    knots = np.r_[begin, stamps, end]
    held = np.vstack([rows, rows[-1:]])
    total = np.vstack([np.zeros((1, rows.shape[1])), np.cumsum(held * np.diff(knots)[:, None], axis=0)])
    edges = np.r_[time[0] - dt_s, time]
    return np.asarray(np.ascontiguousarray(np.diff(evenly(edges, knots, total), axis=0) / dt_s))


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
