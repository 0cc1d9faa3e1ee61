"""One recorded run in SI units, and a set of them."""

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact


@dataclass(frozen=True)
class Recording:
    """One run of a robot; channels that were not recorded are None.

    Attributes
    ----------
    name, session : the run, and the session (day, mounting) that it belongs to
    time : (steps,) s, increasing, not necessarily uniform
    pressure_cmd : (steps, chambers) Pa, what was commanded (``robot.command_to_pa`` times the command channel)
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
