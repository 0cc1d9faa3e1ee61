"""Read a user's dataset folder."""

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

from softrl.core.errors import RecordingError
from softrl.recordings.acting import ACTS, until_rows
from softrl.recordings.load import load_runs
from softrl.recordings.marked import DISTURBED, OUTSIDE, named
from softrl.recordings.recording import RecordingSet
from softrl.recordings.store import DATASET, OF_SESSIONS
from softrl.robots.robot import Robot

OF_ALL = (ACTS, DISTURBED, OUTSIDE)  # what is said of the whole dataset
READ = ("robot", "sessions", *OF_ALL)  # keys that mean something; any other is a note of the user's own
READ_OF_SESSION = ("runs", "axis")
ALIKE, ALIKE_SHORT = 0.85, 0.7  # similarity, of 1, from which another key is one of these misspelt


def read(folder: Path | str, robot: Robot | None) -> RecordingSet:
    """Return the recordings of a dataset folder.

    Parameters
    ----------
    folder : holds ``dataset.yaml`` (robot, sessions, notes) and one ``<run>.csv`` a run
    robot : the robot that made them; None skips every check that needs its limits (a set we wrote ourselves)

    Returns
    -------
    RecordingSet
        In SI units and in the robot's base frame. A dataset without ``sessions`` has one session a run. Times that count
        from an epoch, such as Unix time, are counted from their session's first sample. Commands act until their row's time;
        those of a dataset whose ``command_acts`` is ``from_row`` stand a row later for that.

    Raises
    ------
    RecordingError
        One line that names the file, the line, the column, the value, what was expected and what to do.

    Notes
    -----
    A session may say ``axis: +y``, the direction of the backbone at rest in the frame of that session's
    files. Its positions, forces, markers and orientations are then turned by the shortest rotation that
    brings this axis onto ``robot.axis`` (+z without a robot). That fixes the axis only: a turn about the
    backbone between two sessions remains, and is what the ``frame`` effect (or a registration by session)
    describes.
    """
    recordings = RecordingSet(*load_runs(folder, robot))
    _refuse_misspelt(recordings, Path(folder))
    known = {file.stem for file in Path(folder).glob("*.csv")} | set(recordings.sessions())
    for note in (DISTURBED, OUTSIDE):
        for name in sorted(named(recordings, note) - known):
            raise RecordingError(
                f"{Path(folder) / DATASET}: {note} names '{name}', which is no run and no session; found "
                f"{', '.join(sorted(known))}"
            )
    try:
        return until_rows(recordings)
    except RecordingError as error:
        raise RecordingError(f"{Path(folder) / DATASET}: {error}") from error


def _refuse_misspelt(recordings: RecordingSet, folder: Path) -> None:
    if "axis" in recordings.notes:
        raise RecordingError(f"{folder / DATASET}: key 'axis' would be a note without effect; expected it within a session")
    _refuse_alike(recordings.notes, READ, ALIKE, f"{folder / DATASET}:")
    for name, notes in recordings.notes.get(OF_SESSIONS, {}).items():
        where = f"{folder / DATASET}: session '{name}':"
        for key in (key for key in OF_ALL if key in notes):
            raise RecordingError(f"{where} key '{key}' would be a note without effect; expected it at the top, beside robot")
        _refuse_alike(notes, READ_OF_SESSION, ALIKE_SHORT, where)


def _refuse_alike(notes: Iterable[str], known: Sequence[str], alike: float, where: str) -> None:
    for key in (key for key in notes if key not in known):
        for meant in difflib.get_close_matches(str(key), known, n=1, cutoff=alike):
            raise RecordingError(f"{where} key '{key}' would be a note without effect; did you mean {meant}?")
