"""Write recordings as a dataset folder."""

from pathlib import Path

from softrl.recordings.recording import RecordingSet
from softrl.recordings.store import store_runs


def write(folder: Path | str, recordings: RecordingSet) -> None:
    """Write ``recordings`` to ``folder``: ``dataset.yaml`` and one CSV a run, to be read back by ``recordings.read``.

    Commands are written as pressures, whatever the robot's own command channel was. Nine digits are kept, of times fifteen.
    """
    store_runs(folder, recordings.robot_name, recordings.recordings, recordings.notes)
