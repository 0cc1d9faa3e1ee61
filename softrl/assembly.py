"""Fills the parameters of a stage by their types: artifacts from the store, objects from the configuration."""

import inspect
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softrl.artifacts.artifact import Artifact
from softrl.artifacts.diagnosis import Diagnosis
from softrl.core import fingerprint
from softrl.core.config import TARGET, UNFILLED, build, build_target, constructor_hints, target_class
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.parallel import Parallel
from softrl.core.store import Store
from softrl.effects.chain import EffectChain
from softrl.effects.library import effect_class
from softrl.recordings.read import read as read_recordings
from softrl.recordings.recording import RecordingSet
from softrl.robots.robot import Robot

# parameters of a stage that are built from the configuration group of the same name
OBJECTS = ("simulator", "task", "agent", "driver", "bench")


class Assembly:
    """The arguments of one stage run, and a record of what they were made from.

    Attributes
    ----------
    inputs : artifact name -> run id (or path) that was used
    used : the configuration nodes that can change the result
    modules : modules of the stage and of every class that was built, for the code's fingerprint
    """

    def __init__(self, store: Store, cfg: Mapping[str, Any], made: dict[str, str]) -> None:
        self.store, self.cfg, self.made = store, cfg, made
        self.robot = build(cfg["robot"], Robot, "robot")
        self.robot_mark = fingerprint.of_values(cfg["robot"])
        self.inputs: dict[str, str] = {}
        self.used: dict[str, Any] = {"stage": cfg["stage"], "robot": cfg["robot"]}
        self.modules: list[str] = []
        self._loaded: dict[str, Artifact] = {}

    def arguments(self, run: Any) -> dict[str, Any]:
        """Return the keyword arguments of ``run``, less ``config`` and ``tracker``."""
        self.modules.append(run.__module__)
        hints = typing.get_type_hints(run)
        names = [name for name in inspect.signature(run).parameters if name not in ("config", "tracker")]
        return {name: self._argument(name, hints[name]) for name in names}

    def _argument(self, name: str, hint: Any) -> Any:
        kind, optional = _without_none(hint)
        if kind is RecordingSet:
            return self._recordings(optional)
        if name in OBJECTS:
            return self._object(name)
        artifact = isinstance(kind, type) and issubclass(kind, Artifact)
        filled = None if optional and artifact and self._absent(kind) else self._fill(kind)
        if filled is UNFILLED:
            raise ConfigError(f"the stage asks for '{name}', which no configuration provides")
        return filled

    def _fill(self, hint: Any) -> Any:
        if hint is Robot:
            return self.robot
        if hint is EffectChain:
            return self._chain()
        if hint is Parallel:  # not in ``used``: no result depends on where it was computed
            return build(self.cfg["parallel"], Parallel, "parallel")
        if isinstance(hint, type) and issubclass(hint, Artifact):
            return self._artifact(hint)
        return UNFILLED

    def _object(self, name: str) -> Any:
        node = self.cfg[name]
        self.used[name] = node
        self.modules += _targets(node, name)
        if TARGET not in node:  # several, by name
            return {key: build_target(value, f"{name}.{key}", self._fill) for key, value in node.items()}
        made = build_target(node, name, self._fill)
        parameters = self._identified_parameters() if name == "simulator" else {}
        return made.with_parameters(**parameters) if parameters else made

    def _chain(self) -> EffectChain:
        node = self.cfg["effect"] or {}
        self.used["effect"] = node
        chosen = [build_target(value, f"effect.{key}") for key, value in node.items() if key != "identified"]
        self.modules += [type(effect).__module__ for effect in chosen]
        if "identified" in node:
            for found in self._artifact(Diagnosis).corrections():
                cls = effect_class(found["name"])
                fixed = {"chamber": found["chamber"]} if "chamber" in constructor_hints(cls) else {}
                chosen.append(cls(**found["parameters"], **fixed))
        return EffectChain(self.robot, tuple(chosen))

    def _identified_parameters(self) -> dict[str, float]:
        if "identified" not in (self.cfg["effect"] or {}):
            return {}
        return dict(self._artifact(Diagnosis).simulator_parameters)

    def _recordings(self, optional: bool) -> RecordingSet | None:
        folder = self.cfg["recordings"]
        if folder:
            path = Path(folder).expanduser().resolve()
            found = read_recordings(path, self.robot)
            self.used["recordings"] = self.inputs["recordings"] = f"{path}:{fingerprint.of_folder(path)}"
            return found
        if not optional and self._absent(RecordingSet):
            raise ArtifactError(
                f"there are no recordings of robot {self.robot.name}: name a dataset folder with recordings=<folder>, or "
                "record some with stage=sim2real (stage=excite out=<folder> plans commands that stage=simulate can replay)"
            )
        return None if optional else self._artifact(RecordingSet)

    def _artifact(self, kind: type[Artifact]) -> Any:
        name = kind.key()
        if name not in self._loaded:
            folder, source = self._locate(kind, name)
            found = kind.load(folder)
            owner = getattr(found, "robot_name", self.robot.name)
            if owner != self.robot.name:
                raise ArtifactError(f"inputs.{name}={source} belongs to robot {owner}, but robot={self.robot.name}")
            self.inputs[name], self._loaded[name] = source, found
        return self._loaded[name]

    def _absent(self, kind: type[Artifact]) -> bool:
        """Return whether the newest run that makes ``kind`` was wanted, and there is none."""
        wanted = self.made.get(kind.key()) or self.cfg["inputs"].get(kind.key(), "latest")
        tags = {"stage": kind.stage, "robot": self.robot_mark, "profile": self.cfg["profile"]["name"]}
        return wanted == "latest" and self.store.find(tags) is None

    def _locate(self, kind: type[Artifact], name: str) -> tuple[Path, str]:
        wanted = self.made.get(name) or self.cfg["inputs"].get(name, "latest")
        if wanted.startswith("path:"):
            path = Path(wanted[5:]).expanduser().resolve()
            return path, f"path:{path}:{fingerprint.of_folder(path)}"
        if wanted == "latest":
            tags = {"stage": kind.stage, "robot": self.robot_mark, "profile": self.cfg["profile"]["name"]}
            run = self.store.find(tags)
            if run is None:
                raise ArtifactError(
                    f"no finished {kind.stage} run of robot {self.robot.name} with profile={tags['profile']} holds a "
                    f"{kind.kind()}; run stage={kind.stage} first, or name one with inputs.{name}=run:<id>"
                )
        else:
            run = self.store.get(wanted.removeprefix("run:"))
        return self.store.folder(run, name), run.info.run_id


def output_kinds(run: Any) -> list[type[Artifact]]:
    """Return the artifact classes that a stage function returns, from its annotation."""
    returned = typing.get_type_hints(run)["return"]
    if isinstance(returned, type) and issubclass(returned, Artifact):
        return [returned]
    return list(typing.get_type_hints(returned).values())


def _without_none(hint: Any) -> tuple[Any, bool]:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        kinds = [kind for kind in typing.get_args(hint) if kind is not type(None)]
        return kinds[0], len(kinds) < len(typing.get_args(hint))
    return hint, False


def _targets(node: Any, path: str) -> list[str]:
    if not isinstance(node, Mapping):
        return []
    inner = [module for key, value in node.items() for module in _targets(value, f"{path}.{key}")]
    return inner + ([target_class(node, path).__module__] if TARGET in node else [])
