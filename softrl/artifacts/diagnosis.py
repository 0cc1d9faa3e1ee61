"""What a simulator leaves out, as found in recordings."""

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

from softrl.artifacts.artifact import Artifact
from softrl.core.errors import ArtifactError

LONGEST_S = 1.0  # of one dead time; a log with a row in seconds may be later
VERDICTS = ("nothing missing", "named", "indistinguishable", "unknown")


@dataclass(frozen=True)
class Diagnosis(Artifact):
    """A verdict with its evidence, and what rebuilds the corrected simulator.

    Attributes
    ----------
    robot_name : the robot
    simulator_name : class of the body that was diagnosed
    verdict : one of ``VERDICTS``
    sentences : the finding in plain words, the verdict first
    effects : one entry a named effect: name, site, where, chamber (-1 all), sessions (in which alone it acts, or
        empty), past (whether another session came after them), lasting ("session" or "ever" if its time goes on from run to
        run), parameters ({value, low, high, unit, at_bound}), pinned (parameters held at the value at which they do
        nothing), pinned_intervals ({low, high, unit} of these), evidence (one sentence with numbers)
    simulator_parameters : tunable parameter -> identified value, in the unit of its name
    retuned : tunable parameter -> {nominal, value, lowest, highest, plausible (the data do not drive it to an end
        of that range)}: the competitor that changes parameters only
    rivals : {name, instead_of, score_gap, low, high, unit, equivalent (it does as well), contests (and says something else),
        effect (as in effects, its parameters plain numbers), replaces}, those that contest first, then the nearest beside what
        counts; gaps of the held-out error, of motion in mm or deg, of measured pressure in kPa
    located : {site, channel, chamber, region, effect_size, p_value}, p-values corrected for their number
    errors_mm : train, heldout and, where the dataset marks such runs, ood (out of distribution) -> competitor
        -> rms error, mm; of an angle-only robot arc length times angle
    errors_deg : the same in degrees for an angle-only robot, else empty
    unexplained : what is left after the correction: rms, share, structure
    next_experiment : the program that would separate what is left, or None: separates (what fits alike, if that is open),
        program, the command's limits, and of one that was planned duration_s and separation
    data : findings about the recordings: warnings, runs used for training and held out; level of the parameters' intervals
    late_s : retuned, corrected -> how late the log has it that rows act, found with that simulator, s
    """

    stage: ClassVar[str] = "diagnosis"

    robot_name: str
    simulator_name: str
    verdict: str
    sentences: list[str]
    effects: list[dict[str, Any]]
    simulator_parameters: dict[str, float]
    retuned: dict[str, Any]
    rivals: list[dict[str, Any]]
    located: list[dict[str, Any]]
    errors_mm: dict[str, Any]
    errors_deg: dict[str, Any]
    unexplained: dict[str, Any]
    next_experiment: dict[str, Any] | None
    data: dict[str, Any]
    late_s: dict[str, float] = field(default_factory=dict)

    def validate(self) -> None:
        """Check the verdict against what is named, and the parameters of every effect."""
        super().validate()
        if self.verdict not in VERDICTS:
            raise ArtifactError(f"Diagnosis.verdict='{self.verdict}' is unknown; expected one of {', '.join(VERDICTS)}")
        if self.verdict in ("named", "indistinguishable") and not self.effects:
            raise ArtifactError(f"Diagnosis.verdict='{self.verdict}' without an effect")
        if self.verdict == "nothing missing" and self.effects:
            raise ArtifactError(f"Diagnosis.verdict='nothing missing' but {len(self.effects)} effects")
        for effect in self.effects:
            for name, entry in effect["parameters"].items():
                if not entry["low"] <= entry["value"] <= entry["high"]:
                    raise ArtifactError(
                        f"Diagnosis: {effect['name']}.{name}={entry['value']:g} lies outside its interval "
                        f"{entry['low']:g}..{entry['high']:g}"
                    )

    def corrections(self) -> list[dict[str, Any]]:
        """Return what the corrected simulator contains: every effect that is named, and the log's lateness as a dead time.

        Commands that act late by the log do so for whoever goes by the same clock, whatever the reason.
        """
        return [*self.named(), *late(self.late_s.get("corrected", 0.0))]

    def named(self) -> list[dict[str, Any]]:
        """Return {name, chamber, parameters (name -> value)} of every named effect, as effects are built from.

        What acted in some sessions only, but not in the last, is history, and left out.
        """
        return [
            {
                "name": effect["name"],
                "chamber": effect["chamber"],
                "parameters": effect.get("pinned", {})
                | {name: entry["value"] for name, entry in effect["parameters"].items()},
            }
            for effect in self.effects
            if not effect.get("past", False)
        ]

    def document(self) -> dict[str, Any]:
        """Return the content of ``diagnosis.json``."""
        document: dict[str, Any] = {
            "verdict": self.verdict,
            "summary": self.sentences,
            "effects": self.effects,
            "rivals": self.rivals,
            "located": self.located,
            "errors_mm": self.errors_mm,
            "unexplained": self.unexplained,
            "next_experiment": self.next_experiment,
            "robot": self.robot_name,
            "simulator": self.simulator_name,
            "simulator_parameters": self.simulator_parameters,
            "retuned": self.retuned,
            "late_s": self.late_s,
            "data": self.data,
        }
        if self.errors_deg:
            document["errors_deg"] = self.errors_deg
            document["errors_mm_note"] = "arc length times angle: the robot reports an angle only"
        return document


def late(delay_s: float) -> list[dict[str, Any]]:
    """Return the entries of ``Diagnosis.corrections`` for a log by which commands act ``delay_s`` late; none for one on time."""
    pieces = math.ceil(delay_s / LONGEST_S)
    return [{"name": "dead_time", "chamber": -1, "parameters": {"delay_s": delay_s / pieces}} for _ in range(pieces)]
