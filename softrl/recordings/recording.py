"""Recordings of one robot: the artifact that is stored as a dataset folder."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from softrl.artifacts.artifact import META, Artifact
from softrl.core.errors import ArtifactError
from softrl.recordings.load import load_runs
from softrl.recordings.run import Recording
from softrl.recordings.store import store_runs

__all__ = ["Recording", "RecordingSet"]


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
            lost = () if recording.unseen is None else (("unseen", recording.unseen),)
            for channel, values in (*recording.channels(), *lost):
                if len(values) != len(recording.time):
                    raise ArtifactError(
                        f"run {recording.name}: {channel} has {len(values)} rows, time {len(recording.time)}"
                    )
                if not np.isfinite(values).all():
                    bad = int((~np.isfinite(values)).sum())
                    raise ArtifactError(f"run {recording.name}: {channel} holds {bad} values that are not finite")

    def write(self, folder: Path) -> None:
        """Write a dataset folder, with the artifact's own record beside it."""
        meta = {"kind": self.kind(), "schema": self.schema, "values": {}, "array_dicts": []}
        (folder / META).write_text(json.dumps(meta, indent=1))
        store_runs(folder, self.robot_name, self.recordings, self.notes)

    @classmethod
    def read(cls, folder: Path, meta: dict[str, Any]) -> Self:
        """Read the dataset folder back; it was checked against its robot when it was made."""
        return cls(*load_runs(folder, None))
