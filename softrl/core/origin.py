"""What a run was made with: told in its tags, and asked for where the newest run is taken."""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from softrl.core.config import TARGET

log = logging.getLogger(__name__)


def in_words(node: Mapping[str, Any]) -> str:
    """Return the class that ``node`` is built of, in brackets those that stand within it; numbers are left out."""
    own, *inner = _classes(node)
    return f"{own} ({', '.join(inner)})" if inner else own


def is_real(driver: Mapping[str, Any]) -> bool:
    """Return whether a configured driver speaks to a real device: no body that is simulated stands within it."""
    return len(_classes(driver)) == 1


def _classes(node: Any) -> list[str]:
    if not isinstance(node, Mapping):
        return []
    own = [str(node[TARGET]).rpartition(".")[2]] if TARGET in node else []
    return own + [name for value in node.values() for name in _classes(value)]


@dataclass(frozen=True)
class Origin:
    """What a run should have been made with.

    Attributes
    ----------
    asked : driver and simulator, as far as they count -> what is configured, in words
    binding : whether runs that were made with others are passed over; else that is only told
    """

    asked: Mapping[str, str]
    binding: bool = True

    def newest(self, runs: Iterable[Any]) -> Any:
        """Return the first of ``runs``, the newest first, that may be taken, or None; one that does not tell may."""
        return next((run for run in runs if not (self.binding and self.other(run))), None)

    def other(self, run: Any) -> str:
        """Return in words what a run was made with that was not asked for; nothing if it is as asked, or does not tell."""
        made = {key: run.data.tags.get(f"softrl.{key}", asked) for key, asked in self.asked.items()}
        return ", ".join(f"{key} {value}" for key, value in made.items() if value != self.asked[key])

    def refusal(self, name: str, stage: str, run: Any) -> str:
        """Return what to do where the newest ``run`` may not be taken for the artifact ``name``; nothing if it may."""
        if not (self.binding and (other := self.other(run))):
            return ""
        return (
            f"inputs.{name}=latest: run {run.info.run_id[:8]} was made with {other}, and none with the configured {self}; "
            f"run stage={stage} so first, or insist with inputs.{name}=run:{run.info.run_id[:8]}"
        )

    def warn(self, name: str, run: Any) -> None:
        """Tell of a run that is taken for the artifact ``name`` and was made with others, or does not tell with which."""
        untold = [key for key in self.asked if f"softrl.{key}" not in run.data.tags]
        if other := self.other(run):
            log.warning("inputs.%s=latest is run %s, made with %s; configured is %s", name, run.info.run_id[:8], other, self)
        elif untold and self.binding:
            keys = " and ".join(untold)
            log.warning("inputs.%s=latest is run %s, which does not tell its %s; configured is %s",
                        name, run.info.run_id[:8], keys, self)  # fmt: skip

    def __str__(self) -> str:
        """Return what is asked for in words."""
        return ", ".join(f"{key} {value}" for key, value in self.asked.items())
