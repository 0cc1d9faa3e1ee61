"""Settled holds of recordings: where the command stood still long enough for the tip to be quasi-static."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softrl.core.driver import Driver
from softrl.core.errors import RecordingError
from softrl.recordings.program import random_steps, record, steps_and_holds
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
COMMAND_TOLERANCE_PA = 1.0
LOADED_SHARE = 0.05  # of the largest tip force: about what moves a tip by as much as a settled hold may drift
DRIFT_ROWS = 4  # tell a drift
NOISY = 2.6  # times the mean square of white noise in three axes, which it exceeds in one of twenty holds
AGAIN = "holds_again"  # the recording that visits the first one's pressures in another order


@dataclass(frozen=True)
class Holds:
    """Settled holds.

    Attributes
    ----------
    pressure : (holds, n) Pa commanded at the driver, P_R
    position : (holds, 3) m, mean tip over the end of the hold
    run : (holds,) number of the recording in its set
    last_row : (holds,) last row of the hold in its recording
    """

    pressure: np.ndarray
    position: np.ndarray
    run: np.ndarray
    last_row: np.ndarray

    def __len__(self) -> int:
        return len(self.pressure)

    def where(self, keep: np.ndarray) -> "Holds":
        """Return the holds at which ``keep`` (holds,) bool is true."""
        return Holds(self.pressure[keep], self.position[keep], self.run[keep], self.last_row[keep])


def record_holds(
    driver: Driver, robot: Robot, runs: int, holds: int, hold_s: float, dt_s: float, rng: np.random.Generator,
    again: bool = False, recordings: list[Recording] | None = None,
) -> RecordingSet:  # fmt: skip
    """Return ``runs`` recordings of ``holds`` random constant pressures each, made on the robot behind ``driver``.

    With ``again`` one more follows, ``AGAIN``: the pressures of the first in another order, if its tips were seen. Each run is
    added to ``recordings`` as it comes, so that a caller has those before a fault.
    """
    recordings = [] if recordings is None else recordings
    with driver:
        for run in range(runs):
            time, pressure = random_steps(robot, holds, hold_s, dt_s, rng)
            recordings.append(record(driver, robot, time, pressure, f"holds_{run + 1}", "calibration"))
        rows = [last for _, last in _constant_stretches(recordings[0], 0.5 * hold_s)]
        if again and rows:
            levels = rng.permutation(recordings[0].pressure_cmd[rows])
            recordings.append(record(driver, robot, *steps_and_holds(robot, levels, hold_s, dt_s), AGAIN, "calibration"))
    return RecordingSet(robot.name, tuple(recordings), {"program": f"{holds} random holds of {hold_s:g} s a run"})


def loaded_from_n(robot: Robot) -> float:
    """Return the force, N, above which a tip counts as loaded: no pressure alone brings it where it is."""
    return LOADED_SHARE * robot.tip_force_max_n


def settled_holds(
    recordings: RecordingSet, hold_min_s: float, average_s: float, drift_max_m: float, loaded_n: float = np.inf
) -> Holds:
    """Return the holds of at least ``hold_min_s`` whose tip drifts less than ``drift_max_m`` in the last ``average_s``.

    Holds whose tip feels more than ``loaded_n`` meanwhile are left out.

    Raises
    ------
    RecordingError
        If fewer than four holds are left: a map cannot be fitted to that.
    """
    found, unsettled, untold, loaded = [], 0, 0, 0
    for run, recording in enumerate(recordings.recordings):
        for first, last in _constant_stretches(recording, hold_min_s):
            position, drift = end_of_hold(recording, first, last, average_s)
            drift = drift if recording.seen[_end_rows(recording, first, last, average_s)].all() else np.nan
            felt_n = _felt_at_end(recording, first, last, average_s)
            unsettled += drift >= drift_max_m
            untold += np.isnan(drift)
            loaded += drift < drift_max_m and felt_n > loaded_n
            if drift < drift_max_m and felt_n <= loaded_n:
                found.append((recording.pressure_cmd[last], position, run, last))
    if unsettled:
        log.info("%d holds still moved more than %g mm at their end and are left out", unsettled, 1e3 * drift_max_m)
    if untold:
        told = "%d holds are left out: too few rows, or lost ones, to tell whether they still move; log faster or hold longer"
        log.warning(told, untold)
    if loaded:
        log.warning("%d holds with more than %.3g N on the tip are left out: f_RS is a free tip's", loaded, loaded_n)
    if len(found) < 4:
        raise RecordingError(
            f"recordings of {recordings.robot_name} hold {len(found)} settled holds with tip positions "
            f"({unsettled} still moving, {untold} of too few rows to tell, {loaded} with a force on the tip); "
            f"expected at least 4 of {hold_min_s:g} s: "
            "record constant pressures with a free tip, or lower stage.hold_min_s"
        )
    pressure, position, run_of, last_row = zip(*found, strict=True)
    return Holds(np.array(pressure), np.array(position), np.array(run_of), np.array(last_row))


def moving_rows(
    recordings: RecordingSet, since: Mapping[int, int], settle_s: float, count: int, loaded_n: float = np.inf
) -> Holds | None:
    """Return at most ``count`` rows, evenly over runs, less than ``settle_s`` after a change of the command.

    None if the command never changes. There valves, chambers and body are on their way to where the command leads. Runs and
    their first rows are those of ``since``; rows whose tip feels more than ``loaded_n`` do not count.
    """
    found = []
    for run, first in since.items():
        recording = recordings.recordings[run]
        moving = (_since_change(recording) < settle_s) & (_felt(recording) <= loaded_n) & recording.seen
        for row in first + np.flatnonzero(moving[first:]):
            found.append((recording.pressure_cmd[row], recording.position[row], run, row))
    if not found:
        return None
    chosen = np.unique(np.linspace(0, len(found) - 1, min(count, len(found))).round().astype(int))
    pressure, position, run_of, row_of = zip(*(found[k] for k in chosen), strict=True)
    return Holds(np.array(pressure), np.array(position), np.array(run_of), np.array(row_of))


def revisited(pressure: np.ndarray, answer: np.ndarray) -> tuple[float, int]:
    """Return the rms by which visits of one pressure (holds, n) Pa differ in ``answer`` (holds, n), and how many pressures.

    The spread of a pressure's visits about their mean is what no static map of the pressure can tell. Every pressure that
    was visited more than once counts alike; where there is none, the rms is nan.
    """
    _, group = np.unique(np.round(pressure / COMMAND_TOLERANCE_PA), axis=0, return_inverse=True)
    visits = [answer[group.ravel() == k] for k in range(group.max() + 1)]
    variances = [one.var(axis=0, ddof=1).mean() for one in visits if len(one) > 1]
    return (float(np.sqrt(np.mean(variances))) if variances else np.nan), len(variances)


def _since_change(recording: Recording) -> np.ndarray:
    """Return the time (steps,) s since the command changed last; inf before its first change."""
    changed = np.abs(np.diff(recording.pressure_cmd, axis=0, prepend=recording.pressure_cmd[:1])).max(axis=1)
    last = np.maximum.accumulate(np.where(changed > COMMAND_TOLERANCE_PA, recording.time, -np.inf))
    return recording.time - last


def split_holds(holds: Holds, heldout_share: float, rng: np.random.Generator) -> np.ndarray:
    """Return (holds,) bool: whole runs are held out, or (with a single run) a contiguous end of it."""
    runs = np.unique(holds.run)
    of = len(holds) if len(runs) == 1 else len(runs)
    count = int(np.clip(round(heldout_share * of), 1, of - 1))
    if len(runs) == 1:
        return np.arange(of) >= of - count
    return np.isin(holds.run, rng.permutation(runs)[:count])


def unseen_since(holds: Holds, heldout: np.ndarray) -> dict[int, int]:
    """Return the first row that training has not seen of each run with ``heldout`` (holds,) bool holds.

    That is 0 where the whole run is held out, else the row behind its last hold that is not.
    """
    first: dict[int, int] = {}
    for run in np.unique(holds.run[heldout]):
        seen = holds.last_row[(holds.run == run) & ~heldout]
        first[int(run)] = int(seen.max()) + 1 if len(seen) else 0
    return first


def _constant_stretches(recording: Recording, hold_min_s: float) -> list[tuple[int, int]]:
    """Return (first, last) rows of the stretches of constant command that last ``hold_min_s`` or more."""
    if recording.position is None:
        return []
    changes = np.abs(np.diff(recording.pressure_cmd, axis=0)).max(axis=1) > COMMAND_TOLERANCE_PA
    first = np.concatenate([[0], np.flatnonzero(changes) + 1])
    last = np.concatenate([np.flatnonzero(changes), [len(recording.time) - 1]])
    long = recording.time[last] - recording.time[first] >= 0.98 * hold_min_s
    return list(zip(first[long].tolist(), last[long].tolist(), strict=True))


def end_of_hold(recording: Recording, first: int, last: int, average_s: float) -> tuple[np.ndarray, float]:
    """Return the mean tip (3,) m over the last ``average_s``, and how far it drifts in that time, m.

    What noise may make of it is taken away. Where few rows lie in it the drift is that of ``DRIFT_ROWS``, of half the hold at
    most; nan where those are less than two.
    """
    end = _end_rows(recording, first, last, average_s)
    half_s = 0.5 * float(recording.time[last] - recording.time[first])
    rows = max(end, _end_rows(recording, first, last, half_s)[-DRIFT_ROWS:], key=len)
    half, position = len(rows) // 2, recording.position
    if half == 0:
        return position[end].mean(axis=0), np.nan
    apart_s = recording.time[rows[-half:]].mean() - recording.time[rows[:half]].mean()
    squared = np.sum((position[rows[-half:]].mean(axis=0) - position[rows[:half]].mean(axis=0)) ** 2)
    bent = np.diff(position[rows], 2, axis=0)  # noise alone, of six times its variance
    noise = float(np.sum(bent**2) / (6.0 * len(bent))) * 2.0 / half if len(bent) else 0.0
    return position[end].mean(axis=0), float(np.sqrt(max(squared - NOISY * noise, 0.0)) * average_s / apart_s)


def _end_rows(recording: Recording, first: int, last: int, average_s: float) -> np.ndarray:
    rows = np.arange(first, last + 1)
    return rows[recording.time[rows] > recording.time[last] - average_s]


def _felt_at_end(recording: Recording, first: int, last: int, average_s: float) -> float:
    """Return the size, N, of the mean force on the tip over the last ``average_s``; 0 where none was recorded."""
    if recording.tip_force is None:
        return 0.0
    return float(np.linalg.norm(recording.tip_force[_end_rows(recording, first, last, average_s)].mean(axis=0)))


def _felt(recording: Recording) -> np.ndarray:
    """Return the size (steps,) N of the force on the tip; 0 where none was recorded."""
    if recording.tip_force is None:
        return np.zeros(len(recording.time))
    return np.asarray(np.linalg.norm(recording.tip_force, axis=1))
