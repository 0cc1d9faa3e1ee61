"""When a row's command acts: until the row's time, as simulators take it, or from its time on until the next row's."""

from dataclasses import replace

import numpy as np

from softrl.core.errors import RecordingError
from softrl.recordings.recording import Recording, RecordingSet

ACTS = "command_acts"  # the note of a dataset whose author knows; without it a diagnosis finds out, within a row
UNTIL, FROM = "until_row", "from_row"


def until_rows(recordings: RecordingSet) -> RecordingSet:
    """Return the recordings with commands that act until their row's time, where they are said to act from it on.

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
