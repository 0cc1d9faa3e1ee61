"""Split recordings into those that a fit may see and those it is judged on: never within a run."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from softrl.core.errors import ConfigError, RecordingError
from softrl.recordings.recording import Recording, RecordingSet


def split(
    recordings: RecordingSet, heldout_share: float, seed: int, by: str = "auto"
) -> tuple[RecordingSet, RecordingSet]:
    """Return (training, heldout) with whole groups drawn at random to the held-out side.

    Parameters
    ----------
    recordings : at least two groups
    heldout_share : share of the groups to hold out, in (0, 1); at least one group stays on either side
    seed : of the draw
    by : "session" holds out whole sessions, "run" whole runs, "auto" sessions if there are several, else runs

    Raises
    ------
    RecordingError
        If there is one group only: a held-out error needs a second run.
    """
    if not 0.0 < heldout_share < 1.0:
        raise ConfigError(f"heldout_share={heldout_share:g} must lie between 0 and 1")
    if by not in ("auto", "session", "run"):
        raise ConfigError(f"split by '{by}' is unknown; expected auto, session or run")
    by_session = by == "session" or (by == "auto" and len(recordings.sessions()) > 1)
    groups = recordings.sessions() if by_session else [r.name for r in recordings.recordings]
    if len(groups) < 2:
        kind = "session" if by_session else "run"
        raise RecordingError(
            f"recordings of {recordings.robot_name} hold one {kind} ('{groups[0]}'); expected two or more, "
            "so that a fit can be judged on data it has not seen; record another"
        )
    count = min(max(round(heldout_share * len(groups)), 1), len(groups) - 1)
    chosen = set(np.random.default_rng(seed).permutation(groups)[:count].tolist())
    return (
        _where(recordings, lambda r: (r.session if by_session else r.name) not in chosen),
        _where(recordings, lambda r: (r.session if by_session else r.name) in chosen),
    )


def _where(recordings: RecordingSet, keep: Callable[[Recording], bool]) -> RecordingSet:
    return replace(recordings, recordings=tuple(r for r in recordings.recordings if keep(r)))
