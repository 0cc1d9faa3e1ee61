"""Fills the parameters of a stage by their types: artifacts from the store, objects from the configuration."""

import dataclasses
import inspect
import logging
import sys
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softrl.artifacts.artifact import Artifact
from softrl.artifacts.calibration import Calibration
from softrl.artifacts.diagnosis import Diagnosis
from softrl.artifacts.policy import Policy
from softrl.core import fingerprint
from softrl.core.config import TARGET, UNFILLED, build, build_target, constructor_hints, target_modules
from softrl.core.driver import Stream
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.origin import Origin, in_words, is_real
from softrl.core.parallel import Parallel
from softrl.core.store import Store
from softrl.effects.chain import EffectChain
from softrl.effects.effect import EVERYWHERE, Effect
from softrl.effects.library import effect_class
from softrl.recordings.read import read as read_recordings
from softrl.recordings.recording import RecordingSet
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)

# parameters of a stage that are built from the configuration group of the same name
OBJECTS = ("simulator", "task", "agent", "driver", "bench")
NOMINAL = "none"  # tag of what was made on a simulator without effects
WITH_ORIGIN: tuple[type[Artifact], ...] = (Calibration, RecordingSet)  # what a robot or a rig gave
IDENTIFIED = "identified"  # among the effects: those that a diagnosis found
# what to do instead, where a stage that takes no effects is about them
INSTEAD = {
    "diagnosis": "it looks for all effects itself, beside the nominal simulator; stage.candidates=[..] names those to consider",
    "excite": "stage.hypotheses=[..] lists what to tell apart, inputs.diagnosis=run:<id> plans for what a diagnosis left open",
}


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
        self._takes_effects, self._takes = False, list[str]()
        self._loaded: dict[str, Artifact] = {}

    def arguments(self, run: Any) -> dict[str, Any]:
        """Return the keyword arguments of ``run``, less ``config`` and ``tracker``."""
        self.modules.append(run.__module__)
        hints = typing.get_type_hints(run)
        self._takes_effects = _takes_effects(run)
        self._takes = [name for name in inspect.signature(run).parameters if name not in ("config", "tracker")]
        return {name: self._argument(name, hints[name]) for name in self._takes}

    @property
    def at_device(self) -> bool:
        """Whether the stage works at a real robot."""
        return self._drives and is_real(self.cfg["driver"])

    @property
    def _drives(self) -> bool:
        return "driver" in self.used and "recordings" not in self.used

    def own_tags(self) -> dict[str, str]:
        """Return the tags by which what was made for a task, with effects or with a driver is found, if the stage took such."""
        tags = {"task": _task_of(self.cfg)} if "task" in self.used else {}
        tags |= {"effects": self._effects_mark()} if "effect" in self.used else {}
        tags |= {"driver": in_words(self.cfg["driver"])} if self._drives else {}
        return tags | ({"simulator": in_words(self.cfg["simulator"])} if "simulator" in self.used else {})

    def warn_of_unused(self, stage: str) -> None:
        """Tell of inputs that were named and play no part."""
        for name, source in self.cfg["inputs"].items():
            if source != "latest" and name not in self.inputs:
                taken = ", ".join(self.inputs) or "none"
                log.warning("inputs.%s=%s plays no part in stage=%s, whose inputs are: %s", name, source, stage, taken)

    def refuse_unused_effects(self, stage: str, run: Any) -> None:
        """Raise ``ConfigError`` if effects are chosen, and ``run`` takes none."""
        if self._effects and not _takes_effects(run):
            source = (self.cfg.get("inputs") or {}).get("diagnosis") or IDENTIFIED
            names = [source if name == IDENTIFIED else name for name in self._effects]
            chosen = names[0] if len(names) == 1 else f"[{','.join(names)}]"
            instead = f": {INSTEAD[stage]}" if stage in INSTEAD else ""
            raise ConfigError(f"effect={chosen} plays no part in stage={stage}; leave it out{instead}")

    def _argument(self, name: str, hint: Any) -> Any:
        kind, optional = _without_none(hint)
        if kind is RecordingSet:
            return self._recordings(optional)
        if name in OBJECTS:
            return self._object(name)
        artifact = isinstance(kind, type) and issubclass(kind, Artifact)
        if optional and artifact and self._absent(kind):
            if other := self._other(kind):
                log.warning("there is no %s for what is configured, and none is taken: %s", kind.kind(), other)
            return None
        filled = self._fill(kind)
        if filled is UNFILLED:
            raise ConfigError(f"the stage asks for '{name}', which no configuration provides")
        return filled

    def _fill(self, hint: Any) -> Any:
        if hint is Robot:
            return self.robot
        if hint is EffectChain:
            return self._chain()
        if hint is Stream:
            return Stream(getattr(sys.modules[self.modules[0]], "STREAM", 0))  # of the stage
        if hint is Parallel:  # not in ``used``: no result depends on where it was computed
            return build(self.cfg["parallel"], Parallel, "parallel")
        if isinstance(hint, type) and issubclass(hint, Artifact):
            return self._artifact(hint)
        return UNFILLED

    def _object(self, name: str) -> Any:
        node = self.cfg[name]
        self.used[name] = node
        self.modules += target_modules(node, name)
        if TARGET not in node:  # several, by name
            return {key: build_target(value, f"{name}.{key}", self._fill) for key, value in node.items()}
        made = build_target(node, name, self._fill)
        corrected = name == "simulator" and self._takes_effects and IDENTIFIED in self._effects
        return self._corrected(made) if corrected else made

    @property
    def _effects(self) -> Any:
        """What is configured of effects: nothing with ``effect=none``, and no such key with ``effect=[]``."""
        return self.cfg.get("effect") or {}

    def _chain(self) -> EffectChain:
        node = self._effects
        self.used["effect"] = node
        chosen = [_effect(value, f"effect.{key}", self.robot) for key, value in node.items() if key != IDENTIFIED]
        retuned = False
        if IDENTIFIED in node:
            self.modules.append(Diagnosis.__module__)  # what makes corrections of what was found
            diagnosis = self._artifact(Diagnosis)
            retuned = bool(diagnosis.simulator_parameters)  # see _corrected
            for found in diagnosis.corrections():
                cls = effect_class(found["name"])
                fixed = {"chamber": found["chamber"]} if "chamber" in constructor_hints(cls) else {}
                chosen.append(_corrected_by(found["name"], found["parameters"] | fixed))
        self.modules += [type(effect).__module__ for effect in chosen]
        return EffectChain(self.robot, tuple(chosen), retuned=retuned)

    def _corrected(self, simulator: Any) -> Any:
        """Return the simulator with the parameters that a diagnosis found.

        Raises
        ------
        ArtifactError : it was found with a simulator that has others
        """
        found = self._artifact(Diagnosis)
        made_with, here = found.simulator_name, type(simulator).__name__
        if made_with != here:
            lacking = sorted(set(found.simulator_parameters) - set(simulator.parameters))
            if lacking:
                raise ArtifactError(
                    f"the diagnosis was made with {made_with} and gives its {', '.join(lacking)}, which {here} does not have; "
                    "choose that simulator (simulator=...), or diagnose with this one"
                )
            log.warning("the diagnosis was made with %s, and corrects %s here", made_with, here)
        return simulator.with_parameters(**found.simulator_parameters)

    def _recordings(self, optional: bool) -> RecordingSet | None:
        folder = self.cfg["recordings"]
        if folder:
            path = Path(folder).expanduser().resolve()
            found = read_recordings(path, self.robot)
            self.used["recordings"] = self.inputs["recordings"] = f"{path}:{fingerprint.of_folder(path)}"
            return found
        if not optional and self._absent(RecordingSet) and not self._other(RecordingSet):
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
        return wanted == "latest" and self.latest(kind) is None

    def _tags_of(self, kind: type[Artifact]) -> dict[str, str]:
        """Return what a run must carry whose artifact is taken for the latest."""
        tags = {"stage": kind.stage, "robot": self.robot_mark, "profile": self.cfg["profile"]["name"]}
        tags |= {"effects": NOMINAL} if kind is Calibration else {}
        return tags | ({"task": _task_of(self.cfg)} if kind is Policy else {})

    def _origin(self, kind: type[Artifact]) -> Origin:
        """Return what the newest run should have been made with that makes ``kind``.

        f_RS belongs to a robot and a simulator. What a robot did is so whatever simulates it, and the stages that take
        recordings take no driver: there a real device counts, since it was chosen, and of another that is only told.
        """
        if kind is RecordingSet:
            return Origin({"driver": in_words(self.cfg["driver"])}, is_real(self.cfg["driver"]))
        return Origin({key: in_words(self.cfg[key]) for key in ("driver", "simulator") if key in self._takes})

    def latest(self, kind: type[Artifact]) -> Any:
        """Return the newest run that makes ``kind``, or None.

        A policy is looked for among those trained with the same effects first; f_RS is that of the nominal simulator.
        """
        tags = self._tags_of(kind)
        if kind in WITH_ORIGIN:
            return self._origin(kind).newest(self.store.every(tags))
        if kind is not Policy:
            return self.store.find(tags)
        # the mark of a diagnosis asks for the latest one: it is made where it is needed only
        found = (self.store.find(tags | {"effects": mark}) for mark in (self._effects_mark(), NOMINAL))
        return next(filter(None, found), None)

    def _other(self, kind: type[Artifact]) -> str:
        """Return what to do where the runs that make ``kind`` were all made with others than asked, else nothing."""
        run = self.store.find(self._tags_of(kind)) if kind in WITH_ORIGIN else None
        return "" if run is None else self._origin(kind).refusal(kind.key(), kind.stage, run)

    def _effects_mark(self) -> str:
        """Return what tells the chosen effects from others; those of a diagnosis are known by its run."""
        node = self._effects
        if not node:
            return NOMINAL
        return fingerprint.of_values([node, self._locate(Diagnosis, Diagnosis.key())[1] if IDENTIFIED in node else ""])

    def _nothing_found(self, kind: type[Artifact], name: str) -> str:
        """Return what to do where no run makes the artifact, and what is there instead."""
        tags = self._tags_of(kind)
        task = f" task={tags['task']}" if "task" in tags else ""
        said = {"task": "task", "profile": "profile", "robot": "robot, or with other numbers of this one"}
        less = {key: {other: tag for other, tag in tags.items() if other != key} for key in said if key in tags}
        others = [said[key] for key, fewer in less.items() if self.store.find(fewer)]
        near = f"; there is one with another {' or '.join(others)}" if others else ""
        return (
            f"no finished {kind.stage} run of robot {self.robot.name} with profile={tags['profile']}{task} holds a "
            f"{kind.kind()}{near}; run stage={kind.stage}{task} first, or name one with inputs.{name}=run:<id>"
        )

    def _locate(self, kind: type[Artifact], name: str) -> tuple[Path, str]:
        wanted = self.made.get(name) or self.cfg["inputs"].get(name, "latest")
        if wanted.startswith("path:"):
            path = Path(wanted[5:]).expanduser().resolve()
            return path, f"path:{path}:{fingerprint.of_folder(path)}"
        if wanted == "latest":
            run = self.latest(kind)
            if run is None:
                raise ArtifactError(self._other(kind) or self._nothing_found(kind, name))
            if kind in WITH_ORIGIN:
                self._origin(kind).warn(name, run)
        else:
            run = self.store.get(wanted.removeprefix("run:"))
            made_by = run.data.tags.get("softrl.stage")
            if name not in run.data.tags.get("softrl.artifacts", name).split():
                raise ArtifactError(
                    f"inputs.{name}={wanted} is a run of stage={made_by}, which makes no {kind.kind()}; expected one of "
                    f"stage={kind.stage}"
                )
        return self.store.folder(run, name), run.info.run_id


def _effect(node: Any, path: str, robot: Robot) -> Effect:
    """Return an effect as the configuration imposes it on ``robot``.

    Raises
    ------
    ConfigError : it says how suddenly the effect begins, and not when; or it makes no sense for the robot, or never acts
    """
    effect: Effect = build_target(node, path)
    if "over_s" in node and effect.since_s == 0.0:
        raise ConfigError(f"{path}.over_s={node['over_s']} says how suddenly it begins; expected {path}.since_s > 0 beside it")
    if not effect.suits(robot):
        raise ConfigError(
            f"{path} makes no sense for robot {robot.name} with {robot.chambers} chamber(s), command={robot.command} and "
            f"output={robot.output}; leave it out"
        )
    highest = robot.pressure_max_pa / robot.largest_pa
    if effect.above_share > EVERYWHERE and effect.above_share >= highest:
        raise ConfigError(
            f"{path}.above_share={effect.above_share:g} is no pressure of robot {robot.name}, so that it never acts; expected "
            f"less than {highest:g}, its highest as a share of its largest (suction is below all)"
        )
    return effect


def _corrected_by(name: str, values: dict[str, Any]) -> Effect:
    """Return an effect as a diagnosis found it.

    Raises
    ------
    ArtifactError : the library has since given its parameters other names
    """
    cls = effect_class(name)
    unknown = sorted(set(values) - {field.name for field in dataclasses.fields(cls)})
    if unknown:
        raise ArtifactError(f"the diagnosis gives '{name}' a parameter '{unknown[0]}', unknown by now: run stage=diagnosis again")
    return cls(**values)


def _task_of(cfg: Mapping[str, Any]) -> str:
    """Return the name of the chosen task: that of its file."""
    return str(cfg["task"][TARGET]).split(".")[-2]


def output_kinds(run: Any) -> list[type[Artifact]]:
    """Return the artifact classes that a stage function returns, from its annotation."""
    returned = typing.get_type_hints(run)["return"]
    if isinstance(returned, type) and issubclass(returned, Artifact):
        return [returned]
    return list(typing.get_type_hints(returned).values())


def _takes_effects(run: Any) -> bool:
    return EffectChain in typing.get_type_hints(run).values()


def _without_none(hint: Any) -> tuple[Any, bool]:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        kinds = [kind for kind in typing.get_args(hint) if kind is not type(None)]
        return kinds[0], len(kinds) < len(typing.get_args(hint))
    return hint, False
