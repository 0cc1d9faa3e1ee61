"""What was recorded before a session broke off is kept."""

import logging
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from softrl.core.driver import Driver
from softrl.core.errors import DriverError
from softrl.core.tracking import Tracker
from softrl.recordings.program import recording_of
from softrl.recordings.recording import Recording
from softrl.recordings.store import store_runs
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
FOLDER = "interrupted"


@contextmanager
def keeping(recordings: Sequence[Recording], driver: Driver, robot: Robot, tracker: Tracker) -> Iterator[None]:
    """Store ``recordings`` and the samples of the run that breaks off as a dataset, whatever ends the block early."""
    try:
        yield
    except BaseException as error:
        kept = [*recordings, *_begun(recordings, driver, robot)]
        if kept:
            _store(kept, robot, tracker)
        if isinstance(error, DriverError):
            raise DriverError(f"{error}; {len(kept)} recordings so far are kept in {FOLDER}/ of this run") from error
        raise


def _begun(recordings: Sequence[Recording], driver: Driver, robot: Robot) -> list[Recording]:
    """Return the run that the driver was in, unless it was finished or had hardly begun."""
    samples = list(driver.samples)
    if len(samples) < 2:
        return []
    try:
        begun = recording_of(samples, robot, FOLDER, FOLDER)
    except DriverError as error:
        log.warning("%s: that run is not kept", error)
        return []
    return [] if recordings and _finished(begun, recordings[-1]) else [begun]


def _finished(begun: Recording, last: Recording) -> bool:
    """Return whether ``begun`` is the run ``last``, which has all its samples but those of its venting."""
    channels = dict(begun.channels())
    return all(
        name in channels and np.array_equal(channels[name][: len(values)], values) for name, values in last.channels()
    )


def _store(recordings: list[Recording], robot: Robot, tracker: Tracker) -> None:
    with tempfile.TemporaryDirectory() as folder:
        store_runs(folder, robot.name, tuple(recordings), {"interrupted": True})
        for path in sorted(Path(folder).iterdir()):
            tracker.text(f"{FOLDER}/{path.name}", path.read_text())
    log.warning("%d recordings so far are kept in %s/", len(recordings), FOLDER)
