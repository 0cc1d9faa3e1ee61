"""Write recordings as a dataset folder."""

from pathlib import Path

from softrl.recordings.recording import RecordingSet
from softrl.recordings.store import store_runs
from softrl.robots.robot import Robot


def write(folder: Path | str, recordings: RecordingSet, robot: Robot | None = None) -> None:
    """Write ``recordings`` to ``folder``: ``dataset.yaml`` and one CSV a run, to be read back by ``recordings.read``.

    Commands are written as pressures, or as the own command of the ``robot`` that is to be sent them. Nine digits are
    kept, of times fifteen.
    """
    store_runs(folder, recordings.robot_name, recordings.recordings, recordings.notes, robot)
