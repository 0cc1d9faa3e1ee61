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
AT_ONCE = 0.3  # of steps, which gauges do not show at their own row where commands act from there on
STEPS = 5  # of a chamber, that tell

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
    shown = _shown_at_once(recordings.recordings)
    if shown > AT_ONCE:
        log.warning(
            "%s is %s, but a measured pressure shows %.0f %% of its command's steps at their own row: taken as not known",
            ACTS, FROM, 100.0 * shown,
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


def _shown_at_once(runs: Sequence[Recording]) -> float:
    """Return the share of a step that the measured pressure of the quickest chamber has done at the step's own row."""
    shares: dict[int, list[float]] = {}
    for run in runs:
        if run.pressure_meas is not None:
            for chamber, (command, measured) in enumerate(zip(run.pressure_cmd.T, run.pressure_meas.T, strict=True)):
                shares.setdefault(chamber, []).extend(_steps(np.diff(command), np.diff(measured), float(np.ptp(command))))
    return max((float(np.median(mine)) for mine in shares.values() if len(mine) >= STEPS), default=0.0)


def _steps(change: np.ndarray, answer: np.ndarray, span: float) -> Iterator[float]:
    """Yield what share of every step among the changes (rows,) of a command from row to row is seen in the same row's answer."""
    for k in np.flatnonzero(np.abs(change) >= STEP * max(span, 1e-300)):
        if k >= 2 and np.abs(change[k - 2 : k]).max() <= STILL * abs(change[k]):
            yield float(answer[k] / change[k])
