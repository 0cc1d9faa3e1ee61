"""Runs that a dataset's notes set apart: those in which somebody touched the robot, and those that only judge."""

from dataclasses import replace

from softrl.recordings.load import NAMING
from softrl.recordings.recording import RecordingSet

DISTURBED, OUTSIDE = NAMING


def named(recordings: RecordingSet, *notes: str) -> set[str]:
    """Return the runs and sessions that the ``notes``, such as ``DISTURBED``, name."""
    return {name for note in notes for name in _names(recordings.notes.get(note))}


def without(recordings: RecordingSet, *notes: str) -> RecordingSet:
    """Return the recordings but those that the ``notes``, such as ``DISTURBED``, name by their run or their session."""
    apart = named(recordings, *notes)
    left = tuple(run for run in recordings.recordings if not apart & {run.name, run.session})
    return replace(recordings, recordings=left)


def _names(entry: object) -> tuple[str, ...]:
    """Return the names in a note, which may be one name alone."""
    if isinstance(entry, list | tuple):
        return tuple(str(name) for name in entry)
    return () if entry in (None, "") else (str(entry),)
