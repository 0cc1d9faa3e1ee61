"""When a row's command acts: until the row's time, as simulators take it, or from its time on until the next row's."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from softrl.core.errors import RecordingError
from softrl.recordings.recording import Recording, RecordingSet

ACTS = "command_acts"  # the note of a dataset whose author knows; without it a diagnosis finds out, within a row
UNTIL, FROM = "until_row", "from_row"
STEP, STILL = 0.05, 0.1  # of a command's range in one row: a step; of a step: more in a row before, and it is none
REST_S, REST_ROWS = 0.15, 2  # before a step, both: what a valve is late by, gauges show meanwhile
AT_ONCE = 0.1  # of steps, which gauges do not show at their own row where commands act from there on
AGAINST = 0.3  # of steps, that they must show against what is said
STEPS = 5  # of a chamber, that tell
CERTAIN = 3.0  # standard errors from nothing, below which noise shows as much

log = logging.getLogger(__name__)


def until_rows(recordings: RecordingSet) -> RecordingSet:
    """Return the recordings with commands that act until their row's time, where they are said to act from it on.

    Where gauges show steps earlier than they could what is said cannot be: then nobody knows. Commands that are seen a row
    before their own were written a row late.

    Raises
    ------
    RecordingError
        If the note says something else.
    """
    said = recordings.notes.get(ACTS)
    if said not in (None, UNTIL, FROM):
        raise RecordingError(
            f"{ACTS} is '{said}'; expected {UNTIL} or {FROM}, or no such key where nobody knows when a row's command acts"
        )
    runs, notes = recordings.recordings, {key: note for key, note in recordings.notes.items() if key != ACTS}
    if (shown := _shown(runs, 1)) > (AT_ONCE if said is None else AGAINST):
        log.warning("%s a row before their own: taken as written a row late", _steps_are_seen(shown))
        return replace(recordings, recordings=tuple(_by_a_row(run, -1) for run in runs), notes=notes)
    if said == FROM and (shown := _shown(runs, 0)) > AGAINST:
        log.warning("%s is %s, but %s at their own row: taken as not known", ACTS, FROM, _steps_are_seen(shown))
        return replace(recordings, notes=notes)
    if said != FROM:
        return recordings
    return replace(recordings, recordings=tuple(_by_a_row(run, 1) for run in runs), notes=notes | {ACTS: UNTIL})


def is_known(recordings: RecordingSet) -> bool:
    """Return whether it is known when commands act: then a log is late by nothing."""
    return recordings.notes.get(ACTS) is not None


def _by_a_row(run: Recording, later: int) -> Recording:
    """Return the run with commands that stand a row ``later``, 1, or earlier, -1."""
    rows = np.clip(np.arange(len(run.time)) - later, 0, len(run.time) - 1)
    return replace(run, pressure_cmd=run.pressure_cmd[rows])


def _steps_are_seen(share: float) -> str:
    return f"a measured pressure shows {share:.0%} of its command's steps"


def _shown(runs: Sequence[Recording], before: int) -> float:
    """Return the share of a step that the measured pressure of the quickest chamber does ``before`` rows ahead of its own row.

    What noise of gauges may show is nothing.
    """
    shares: dict[int, list[float]] = {}
    for run in runs:
        if run.pressure_meas is not None:
            rest = max(REST_ROWS, int(np.ceil(REST_S / float(np.median(np.diff(run.time))) - 1e-6)))
            for chamber, (command, measured) in enumerate(zip(run.pressure_cmd.T, run.pressure_meas.T, strict=True)):
                shares.setdefault(chamber, []).extend(_steps(command, measured, before, rest))
    return max((_certain(np.array(mine)) for mine in shares.values() if len(mine) >= STEPS), default=0.0)


def _certain(shares: np.ndarray) -> float:
    """Return the median of ``shares`` (steps,), or 0 where it is within the error that Gaussian noise gives it."""
    median = float(np.median(shares))
    spread = 1.4826 * float(np.median(np.abs(shares - median)))
    return median if abs(median) > CERTAIN * np.sqrt(0.5 * np.pi / len(shares)) * spread else 0.0


def _steps(command: np.ndarray, measured: np.ndarray, before: int, rest: int) -> Iterator[float]:
    """Yield the share of every step of a command (rows,), out of ``rest``, that is measured ``before`` rows ahead of its own row.

    Behind a slow valve a gauge is still on its way from the step before: what was under way that way a row earlier is taken off.
    """
    change, answer = np.diff(command), np.diff(measured)
    for k in np.flatnonzero(np.abs(change) >= STEP * max(np.ptp(command), 1e-300)):
        if k >= rest and np.abs(change[k - rest : k]).max() <= STILL * abs(change[k]):
            shown, under_way = answer[k - before] / change[k], answer[k - before - 1] / change[k]
            yield float(shown - max(under_way, 0.0))
