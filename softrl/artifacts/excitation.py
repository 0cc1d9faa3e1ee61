"""A pressure program planned to tell hypotheses apart."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError


@dataclass(frozen=True)
class Excitation(Artifact):
    """A planned program with what it is expected to tell apart.

    Attributes
    ----------
    robot_name : the robot
    time : (steps,) s, each row of pressure is held until its time
    pressure : (steps, chambers) Pa gauge
    blocks : {label, start_s, duration_s}, in order
    pairs : {first, second, parameters ({label: {effect.name: value}} at which both resemble each other under the default
        program), separation_sigma ({planned, default, random}: distance
        left after a full refit, in standard deviations of the noise, of the way round that is told apart worse)}
    """

    stage: ClassVar[str] = "excite"

    robot_name: str
    time: np.ndarray
    pressure: np.ndarray
    blocks: list[dict[str, Any]]
    pairs: list[dict[str, Any]]

    def validate(self) -> None:
        """Check that every time has a row of pressures."""
        super().validate()
        if self.pressure.ndim != 2 or len(self.pressure) != len(self.time):
            raise ArtifactError(f"Excitation.pressure has shape {self.pressure.shape}, time {self.time.shape}")

    def document(self) -> dict[str, Any]:
        """Return the content of ``excite.json``."""
        return {
            "robot": self.robot_name,
            "duration_s": float(self.time[-1]),
            "blocks": self.blocks,
            "pairs": self.pairs,
        }
