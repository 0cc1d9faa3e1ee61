"""Runs that a dataset's notes set apart: those in which somebody touched the robot, and those that only judge."""

from dataclasses import replace

from softrl.recordings.recording import RecordingSet

DISTURBED = "disturbed"
OUTSIDE = "out_of_distribution"


def without(recordings: RecordingSet, *notes: str) -> RecordingSet:
    """Return the recordings but those that the ``notes``, such as ``DISTURBED``, name by their run or their session."""
    named = {name for note in notes for name in _names(recordings.notes.get(note))}
    left = tuple(run for run in recordings.recordings if not named & {run.name, run.session})
    return replace(recordings, recordings=left)


def _names(entry: object) -> tuple[str, ...]:
    """Return the names in a note, which may be one name alone."""
    if isinstance(entry, list | tuple):
        return tuple(str(name) for name in entry)
    return () if entry is None else (str(entry),)
