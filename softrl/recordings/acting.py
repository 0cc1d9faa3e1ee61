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
AT_ONCE = 0.1  # of steps, which gauges do not show at their own row where commands act from there on
STEPS = 5  # of a chamber, that tell

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
    if (shown := _shown(runs, 1)) > AT_ONCE:
        log.warning("%s a row before their own: taken as written a row late", _steps_are_seen(shown))
        return replace(recordings, recordings=tuple(_by_a_row(run, -1) for run in runs), notes=notes)
    if said == FROM and (shown := _shown(runs, 0)) > AT_ONCE:
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
    """Return the share of a step that the measured pressure of the quickest chamber does ``before`` rows ahead of its own row."""
    shares: dict[int, list[float]] = {}
    for run in runs:
        if run.pressure_meas is not None:
            for chamber, (command, measured) in enumerate(zip(run.pressure_cmd.T, run.pressure_meas.T, strict=True)):
                shares.setdefault(chamber, []).extend(_steps(command, measured, before))
    return max((float(np.median(mine)) for mine in shares.values() if len(mine) >= STEPS), default=0.0)


def _steps(command: np.ndarray, measured: np.ndarray, before: int) -> Iterator[float]:
    """Yield the share of every step of a command (rows,), out of rest, that is measured ``before`` rows ahead of its own row."""
    change, answer = np.diff(command), np.diff(measured)
    for k in np.flatnonzero(np.abs(change) >= STEP * max(np.ptp(command), 1e-300)):
        if k >= 2 and np.abs(change[k - 2 : k]).max() <= STILL * abs(change[k]):
            yield float(answer[k - before] / change[k])
