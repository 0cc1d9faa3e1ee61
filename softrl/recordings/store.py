"""Write recordings as a dataset folder: ``dataset.yaml`` and one CSV a run, in the units that people read."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from softrl.core.errors import RecordingError
from softrl.core.units import si_factor
from softrl.recordings.run import Recording
from softrl.robots.robot import Robot

DATASET = "dataset.yaml"
OF_SESSIONS = "session_notes"  # the note that holds those of sessions, by session
TIME, OTHER = "%.15g", "%.9g"  # nine digits of a time that goes on for days are too few
UNITS = {
    "time": "s",
    "pressure": "kPa gauge",
    "position": "mm",
    "orientation": "quaternion w x y z",
    "angle": "deg",
}


def store_runs(
    folder: Path | str, robot_name: str, recordings: tuple[Recording, ...], notes: dict[str, Any], robot: Robot | None = None
) -> None:
    """Write runs and notes to ``folder``; see ``recordings.write``. Commands are those of ``robot``, or else pressures."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    names = [r.name for r in recordings]
    for name in names:
        if names.count(name) > 1 or Path(name).name != name or not name:
            raise RecordingError(f"run '{name}' cannot be a file name of its own; rename it")
    for recording in recordings:
        _write_run(folder / f"{recording.name}.csv", recording, robot)
    head = {"robot": robot_name, "frame": "base", "units": UNITS, "sessions": _sessions(recordings, notes)}
    rest = {key: value for key, value in notes.items() if key != OF_SESSIONS}
    (folder / DATASET).write_text(yaml.safe_dump(head | rest, sort_keys=False, width=110))


def _sessions(recordings: tuple[Recording, ...], notes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    sessions: dict[str, dict[str, Any]] = {}
    for recording in recordings:
        sessions.setdefault(recording.session, {"runs": []})["runs"].append(recording.name)
    extras = notes.get(OF_SESSIONS, {})
    return {session: entry | extras.get(session, {}) for session, entry in sessions.items()}


def command_columns(pressure: np.ndarray, robot: Robot | None) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the columns of commands (steps, chambers) Pa by name: the ``robot``'s own command, where it has one, or kPa."""
    for i, column in enumerate(pressure.T):
        if robot is None or robot.command == "pressure":
            yield from _scaled(f"p{i + 1}_cmd_kpa", column)
        else:
            number = "" if robot.chambers == 1 else f"{i + 1}"
            yield f"{robot.command}{number}_cmd", column / robot.command_to_pa


def _write_run(path: Path, recording: Recording, robot: Robot | None) -> None:
    header, columns = zip(*_columns(recording, robot), strict=True)
    digits = [TIME if name == "time_s" else OTHER for name in header]
    np.savetxt(path, np.stack(columns, axis=1), fmt=digits, delimiter=",", header=",".join(header), comments="")


def _columns(recording: Recording, robot: Robot | None) -> Iterator[tuple[str, np.ndarray]]:
    def seen(motion: np.ndarray) -> np.ndarray:
        return np.where(recording.seen, motion, np.nan)

    yield "time_s", recording.time
    yield from command_columns(recording.pressure_cmd, robot)
    if recording.pressure_meas is not None:
        for i in range(recording.pressure_meas.shape[1]):
            yield from _scaled(f"p{i + 1}_meas_kpa", recording.pressure_meas[:, i])
    for name, values, unit in (
        ("tip", recording.position, "mm"),
        *((marker, place, "mm") for marker, place in recording.markers.items()),
        ("force", recording.tip_force, "n"),
    ):
        if values is not None:
            for i, axis in enumerate("xyz"):
                yield from _scaled(f"{name}_{axis}_{unit}", values[:, i] if name == "force" else seen(values[:, i]))
    if recording.quaternion is not None:
        for i, axis in enumerate("wxyz"):
            yield f"tip_q{axis}", seen(recording.quaternion[:, i])
    if recording.bend_angle is not None:
        yield from _scaled("bend_angle_deg", seen(recording.bend_angle))
    if recording.temperature is not None:
        yield "temp_c", recording.temperature


def _scaled(column: str, values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    yield column, values / si_factor(column)
