"""When a row's command acts: until the row's time, as simulators take it, or from its time on until the next row's."""

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from softrl.core.errors import RecordingError
from softrl.recordings.recording import Recording, RecordingSet

ACTS = "command_acts"  # the note of a dataset whose author knows; without it a diagnosis finds out, within a row
UNTIL, FROM = "until_row", "from_row"
STEP, STILL = 0.05, 0.1  # of a command's range in one row: a step; of a step: more in a row before, and it is none
AT_ONCE = 0.3  # of steps, which gauges do not show at their own row where commands act from there on
STEPS = 5  # that tell

log = logging.getLogger(__name__)


def until_rows(recordings: RecordingSet) -> RecordingSet:
    """Return the recordings with commands that act until their row's time, where they are said to act from it on.

    Where gauges show steps at their own row what is said cannot be: then nobody knows.

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
    if said != FROM:
        return recordings
    shown = [share for run in recordings.recordings for share in _shown_at_once(run)]
    if len(shown) >= STEPS and float(np.median(shown)) > AT_ONCE:
        log.warning(
            "%s is %s, but measured pressures show %.0f %% of %d steps at the step's own row: taken as not known",
            ACTS, FROM, 100.0 * float(np.median(shown)), len(shown),
        )  # fmt: skip
        return replace(recordings, notes={key: note for key, note in recordings.notes.items() if key != ACTS})
    return replace(
        recordings,
        recordings=tuple(_a_row_later(run) for run in recordings.recordings),
        notes=recordings.notes | {ACTS: UNTIL},
    )


def is_known(recordings: RecordingSet) -> bool:
    """Return whether it is known when commands act: then a log is late by nothing."""
    return recordings.notes.get(ACTS) is not None


def _a_row_later(run: Recording) -> Recording:
    return replace(run, pressure_cmd=np.vstack([run.pressure_cmd[:1], run.pressure_cmd[:-1]]))


def _shown_at_once(run: Recording) -> Iterator[float]:
    """Yield the share of every step of a command that its measured pressure has done at the step's own row."""
    if run.pressure_meas is None:
        return
    for command, measured in zip(run.pressure_cmd.T, run.pressure_meas.T, strict=True):
        change, answer = np.diff(command), np.diff(measured)
        for k in np.flatnonzero(np.abs(change) >= STEP * max(np.ptp(command), 1e-300)):
            if k >= 2 and np.abs(change[k - 2 : k]).max() <= STILL * abs(change[k]):
                yield float(answer[k] / change[k])
