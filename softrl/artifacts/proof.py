"""What blind trials of the diagnosis gave."""

from dataclasses import dataclass
from typing import Any, ClassVar

from softrl.artifacts.artifact import Artifact


@dataclass(frozen=True)
class Proof(Artifact):
    """Blind trials, scored.

    Attributes
    ----------
    robot_name : the robot
    metrics : name with unit -> value; null where no case counts
    rows : one entry a case, as in ``proof.csv``
    misses : one sentence for every case that went wrong
    key_sha256, catalogue_sha256 : of the sealed key, and of the frozen table of right answers
    """

    stage: ClassVar[str] = "proof"

    robot_name: str
    metrics: dict[str, Any]
    rows: list[dict[str, Any]]
    misses: list[str]
    key_sha256: str
    catalogue_sha256: str
