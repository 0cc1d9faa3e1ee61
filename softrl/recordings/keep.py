"""What was recorded before a session broke off is kept."""

import logging
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from softrl.core.driver import Driver, Sample
from softrl.core.errors import DriverError
from softrl.core.tracking import Tracker
from softrl.recordings.program import recording_of
from softrl.recordings.recording import Recording
from softrl.recordings.store import store_runs
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
FOLDER = "interrupted"
# channel of a recording -> the same in a sample
REPORTED = {
    "pressure_cmd": "commanded", "pressure_meas": "pressure", "position": "position", "quaternion": "quaternion",
    "tip_force": "tip_force",
}  # fmt: skip


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
    samples, last = list(driver.samples), None
    for run in recordings:
        if _holds(samples, run):  # finished since the driver was entered: it is kept already
            samples, last = [s for s in samples if s.time_s > run.time[-1]], run.pressure_cmd[-1]
    if len(samples) < 2 or (last is not None and _ends(samples, last)):
        return []
    try:
        return [recording_of(samples, robot, FOLDER, FOLDER)]
    except DriverError as error:
        log.warning("%s: that run is not kept", error)
        return []


def _holds(samples: list[Sample], run: Recording) -> bool:
    """Return whether all that ``run`` tells is among ``samples``."""
    by_time = {sample.time_s: sample for sample in samples}
    rows = [by_time[time_s] for time_s in run.time.tolist() if time_s in by_time]
    return len(rows) == len(run.time) and all(
        np.array_equal(np.stack([getattr(row, REPORTED[name]) for row in rows]), values)
        for name, values in run.channels()
        if name in REPORTED
    )


def _ends(samples: list[Sample], last: np.ndarray) -> bool:
    """Return whether ``samples`` go on with a run's ``last`` command (chambers,) Pa until they are vented, and no further."""
    commanded = np.stack([sample.commanded for sample in samples])
    return bool(((commanded == last).all(axis=1) | (commanded == 0.0).all(axis=1)).all())


def _store(recordings: list[Recording], robot: Robot, tracker: Tracker) -> None:
    failure: Exception | None = None
    with tempfile.TemporaryDirectory() as folder:
        store_runs(folder, robot.name, tuple(recordings), {"interrupted": True})
        for path in sorted(Path(folder).iterdir()):
            try:
                tracker.text(f"{FOLDER}/{path.name}", path.read_text())
            except Exception as error:  # a server that is gone may be what broke off; texts are written beside it first
                failure = error
    if failure is not None:
        log.error("recordings so far are kept in %s/ of the output folder at best, not in the run: %s", FOLDER, failure)
        return
    log.warning("%d recordings so far are kept in %s/", len(recordings), FOLDER)
