"""The form in which an effect acts, as a diagnosis tells it: its chamber, gate, session and side of the gauge."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from softrl.effects.effect import Effect
from softrl.effects.gate import GATES
from softrl.effects.library import effect_class

FLAGS = {"before_gauge": "before the gauge", "behind_gauge": "behind the gauge"}  # as labels say it


@dataclass(frozen=True)
class Form:
    """An effect and where and when it acts.

    Attributes
    ----------
    name, chamber : of the effect, and -1 for all chambers or where it knows none
    sessions : in which alone it acts, or empty
    past : whether that is over, so that it does nothing to what is recorded from now on
    values : field -> what was fitted, pinned or is known of its clock and gauge; what is missing is typical
    """

    name: str
    chamber: int
    sessions: tuple[str, ...]
    past: bool
    values: Mapping[str, Any]

    @property
    def label(self) -> str:
        """Return how it is called in results."""
        where = [f"chamber {self.chamber + 1}"] * (self.chamber >= 0)
        where += [words for field, words in (GATES | FLAGS).items() if field in self.values]
        return f"{self.name} ({', '.join(where)})" if where else self.name

    @property
    def listed(self) -> str:
        """Return how the nearest to it stands in ``stage.hypotheses``."""
        return self.name if self.chamber < 0 else f"{self.name}@{self.chamber + 1}"

    def same_as(self, other: "Form") -> bool:
        """Return whether both are the same effect at the same place."""
        sides = [[form.values.get(flag, False) for flag in FLAGS] for form in (self, other)]
        return (self.name, self.chamber, self.sessions, sides[0]) == (other.name, other.chamber, other.sessions, sides[1])

    def build(self) -> Effect:
        """Return the effect."""
        cls = effect_class(self.name)
        typical = {field.name: field.metadata["typical"] for field in cls.parameter_fields()}
        alone = {"chamber": self.chamber} if any(field.name == "chamber" for field in fields(cls)) else {}
        return cls(**typical | dict(self.values) | alone)


def form_of(entry: Mapping[str, Any]) -> Form:
    """Return the form of an entry of a diagnosis: of a named effect, or of what a rival is and replaces."""
    values = {n: p["value"] if isinstance(p, Mapping) else p for n, p in entry.get("parameters", {}).items()}
    sessions = tuple(entry.get("sessions", ()))
    return Form(entry["name"], entry["chamber"], sessions, entry.get("past", False), entry.get("pinned", {}) | values)


def form_of_label(label: str) -> Form:
    """Return the form that a label tells, such as ``leak (chamber 2, from a time on)``: all that older diagnoses have.

    What was fitted is not told, and becomes typical.
    """
    name, _, where = label.partition(" (")
    chamber, sessions = -1, tuple[str, ...]()
    values: dict[str, Any] = {}
    known = {field.name: field.metadata["typical"] for field in effect_class(name).gate_fields()}
    told = {words: field for field, words in (GATES | FLAGS).items()}
    for words in where.removesuffix(")").split(", "):
        if words.startswith("chamber "):
            chamber = int(words.removeprefix("chamber ")) - 1
        elif words.startswith("session "):
            sessions = (words.removeprefix("session "),)
        elif words in told:
            values[told[words]] = known.get(told[words], True)
    return Form(name, chamber, sessions, bool(sessions), values)
