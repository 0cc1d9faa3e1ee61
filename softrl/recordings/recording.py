"""One recorded run in SI units, and a set of them."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from softrl.artifacts.artifact import META, Artifact
from softrl.core.errors import ArtifactError


@dataclass(frozen=True)
class Recording:
    """One run of a robot; channels that were not recorded are None.

    Attributes
    ----------
    name, session : the run, and the session (day, mounting) that it belongs to
    time : (steps,) s, increasing, not necessarily uniform
    pressure_cmd : (steps, chambers) Pa, what was commanded (``robot.command_to_pa`` times the command
        channel)
    pressure_meas : (steps, chambers) Pa gauge at the chamber
    position : (steps, 3) m, tip in the base frame
    quaternion : (steps, 4) w x y z
    bend_angle : (steps,) rad
    tip_force : (steps, 3) N on the tip, base frame
    markers : name -> (steps, 3) m
    temperature : (steps,) degree Celsius
    """

    name: str
    session: str
    time: np.ndarray
    pressure_cmd: np.ndarray
    pressure_meas: np.ndarray | None = None
    position: np.ndarray | None = None
    quaternion: np.ndarray | None = None
    bend_angle: np.ndarray | None = None
    tip_force: np.ndarray | None = None
    markers: dict[str, np.ndarray] = field(default_factory=dict)
    temperature: np.ndarray | None = None

    def channels(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the recorded channels by name, markers by their own."""
        for entry in fields(self):
            values = getattr(self, entry.name)
            if isinstance(values, np.ndarray):
                yield entry.name, values
        yield from self.markers.items()


@dataclass(frozen=True)
class RecordingSet(Artifact):
    """Recordings of one robot; stored as a dataset folder (dataset.yaml and one CSV a run)."""

    stage: ClassVar[str] = "sim2real"

    robot_name: str
    recordings: tuple[Recording, ...]
    notes: dict[str, Any] = field(default_factory=dict)

    def sessions(self) -> list[str]:
        """Return the names of the sessions in order of appearance."""
        return list(dict.fromkeys(r.session for r in self.recordings))

    def validate(self) -> None:
        """Check that every channel of every run has one finite row per time."""
        for recording in self.recordings:
            for channel, values in recording.channels():
                if len(values) != len(recording.time):
                    raise ArtifactError(
                        f"run {recording.name}: {channel} has {len(values)} rows, time {len(recording.time)}"
                    )
                if not np.isfinite(values).all():
                    bad = int((~np.isfinite(values)).sum())
                    raise ArtifactError(f"run {recording.name}: {channel} holds {bad} values that are not finite")

    def write(self, folder: Path) -> None:
        """Write a dataset folder, with the artifact's own record beside it."""
        from softrl.recordings.write import write  # reader and writer know this class

        meta = {"kind": self.kind(), "schema": self.schema, "values": {}, "array_dicts": []}
        (folder / META).write_text(json.dumps(meta, indent=1))
        write(folder, self)

    @classmethod
    def read(cls, folder: Path, meta: dict[str, Any]) -> Self:
        """Read the dataset folder back; it was checked against its robot when it was made."""
        from softrl.recordings.read import read

        found = read(folder, None)
        return cls(robot_name=found.robot_name, recordings=found.recordings, notes=found.notes)
