"""A hypothesis: which effects act, which simulator parameters are free, and their scaled coordinates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from softrl.core.simulator import Simulator
from softrl.effects.effect import Effect
from softrl.effects.gate import GATES, WIDTHS
from softrl.effects.library import effect_class

NEW = (0.0, 0.0, 0.0)  # how long a run, its session and all sessions had gone on before the first sample
LASTING = {"session": "lasting through a session", "ever": "lasting"}
MOMENTS = ("since_s", "onset_s")  # parameters that say from when on something acts
LATE = "late_s"  # how late a log has it that rows act, tuned with the simulator's parameters
LATE_SCALE = 12.0  # sampling intervals that are one scaled unit: what a log may be late counts as no far retuning
GUESSED = ("damping_s", "damping_scale")  # what no file knows well, and of which less looks like nothing that was left out
MASS = "mass_scale"  # which a scale would show
AT_END = 0.97  # a retuned parameter this close to the end of its range (in logarithms) is not plausible
FULL_TURN_RAD = 6.0  # a parameter in rad with a wider range than this is a direction


class Gate(NamedTuple):
    """That an effect acts above a pressure or from a time on only: the field of the effect, and where a search begins."""

    field: str
    begin: float


class Choice(NamedTuple):
    """One effect of the library; ``chamber`` is -1 for all chambers, or where the effect knows none.

    ``pinned`` names the parameters that are held at their neutral values; ``gate`` says above which pressure or from when on
    alone it acts, ``sessions`` in which of them alone, if not in all; ``before_gauge`` that gauges show it,
    ``behind_gauge`` that they do not. ``lasting`` says that its clock goes on from run to run, through its "session" or for
    "ever"; else it begins anew with every run.
    """

    name: str
    chamber: int = -1
    pinned: tuple[str, ...] = ()
    gate: Gate | None = None
    sessions: tuple[str, ...] = ()
    before_gauge: bool = False
    behind_gauge: bool = False
    lasting: str = ""

    def label(self) -> str:
        """Return the name, with the chamber (counted from 1), the gate and the sessions where it acts there alone."""
        where = [f"chamber {self.chamber + 1}"] * (self.chamber >= 0) + [self.period] * bool(self.sessions)
        where += [GATES[self.gate.field]] if self.gate else []
        where += [self.gauge] if self.gauge else []
        where += [LASTING[self.lasting]] if self.lasting else []
        return f"{self.name} ({', '.join(where)})" if where else self.name

    @property
    def period(self) -> str:
        """In words in which sessions it acts, where not in all; else empty."""
        if len(self.sessions) <= 1:
            return "".join(f"session {session}" for session in self.sessions)
        between = "and" if len(self.sessions) == 2 else "to"
        return f"sessions {self.sessions[0]} {between} {self.sessions[-1]}"

    @property
    def gauge(self) -> str:
        """In words on which side of the gauge it acts, where its effect may be on either; else empty."""
        return "before the gauge" if self.before_gauge else "behind the gauge" if self.behind_gauge else ""

    @property
    def pinned_widths(self) -> tuple[str, ...]:
        """What of its gate is pinned: how long that takes to open, whatever the law."""
        return tuple(name for name in self.pinned if name in WIDTHS.values())

    @property
    def site(self) -> str:
        """Where along the pipeline it acts."""
        return "valve" if self.before_gauge else "chamber" if self.behind_gauge else effect_class(self.name).site

    @property
    def shifts_time(self) -> bool:
        """Whether it does what a late log does, everywhere and always."""
        return effect_class(self.name).shifts_time and self._everywhere

    @property
    def retunes(self) -> bool:
        """Whether it does what retuning does: no physics that was left out, and no way past the plausible range."""
        return effect_class(self.name).retunes and self._everywhere

    @property
    def _everywhere(self) -> bool:
        return self.chamber < 0 and not (self.gate or self.sessions)


class Axis(NamedTuple):
    """One free parameter and its scaled coordinate u: ``zero + scale u``, or ``zero exp(u)`` if ``log``."""

    owner: str
    name: str
    unit: str
    low: float
    high: float
    zero: float
    scale: float
    log: bool

    @property
    def is_direction(self) -> bool:
        """Whether it is an angle that has no end: searches begin in several directions, and may pass a full turn."""
        return self.unit == "rad" and self.high - self.low > FULL_TURN_RAD

    def scaled(self, value: float) -> float:
        """Return u of a physical value."""
        return math.log(value / self.zero) if self.log else (value - self.zero) / self.scale

    def physical(self, u: float) -> float:
        """Return the value at u, within the bounds."""
        value = self.zero * math.exp(min(max(u, -50.0), 50.0)) if self.log else self.zero + self.scale * u
        return min(max(value, self.low), self.high)


@dataclass(frozen=True)
class Hypothesis:
    """Effects that act, and names of the simulator parameters that are refitted with them."""

    effects: tuple[Choice, ...]
    tuned: tuple[str, ...]

    def label(self) -> str:
        """Return the names joined."""
        return " + ".join(choice.label() for choice in self.effects) or "retuned"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects, each of which acts once."""
        return tuple(choice.name for choice in self.effects)

    def named(self, name: str) -> Choice | None:
        """Return the effect of that name in the form in which it acts, None if it does not."""
        return next((choice for choice in self.effects if choice.name == name), None)

    def with_effect(self, choice: Choice) -> "Hypothesis":
        """Return the hypothesis with one effect more."""
        return Hypothesis((*self.effects, choice), self.tuned)

    def without(self, choice: Choice) -> "Hypothesis":
        """Return the hypothesis with one effect less."""
        return Hypothesis(tuple(c for c in self.effects if c != choice), self.tuned)


@dataclass(frozen=True)
class Space:
    """The free parameters of a hypothesis: effects first, in order, then the simulator's and how late the log is.

    The simulator's parameters may change by ``tuned_factor`` either way, its damping down to the square of that, its mass by
    ``mass_factor`` at most. The log may be late by ``late_max_s``, ``late_apart_s`` where an effect shifts motion in time itself.
    """

    hypothesis: Hypothesis
    simulator: Simulator
    tuned_factor: float
    late_max_s: float = 0.0
    late_apart_s: float = 0.0
    mass_factor: float = np.inf

    @cached_property
    def axes(self) -> tuple[Axis, ...]:
        """One axis a free parameter."""
        mine = [axis for choice in self.hypothesis.effects for axis in effect_axes(choice)]
        return (*mine, *(self._late if name == LATE else self._retuned(name) for name in self.hypothesis.tuned))

    def _retuned(self, name: str) -> Axis:
        nominal, factor = self.simulator.parameters[name], min(self.tuned_factor, self.mass_factor if name == MASS else np.inf)
        least = nominal / factor ** (2 if name in GUESSED else 1)
        return Axis("simulator", name, "", least, nominal * factor, nominal, 1.0, True)

    @property
    def _late(self) -> Axis:
        shifted = any(choice.shifts_time for choice in self.hypothesis.effects)
        most = self.late_apart_s if shifted else self.late_max_s
        return Axis("log", LATE, "s", 0.0, most, 0.0, LATE_SCALE * self.late_max_s, False)

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest scaled point (p,)."""
        ends = np.array([sorted((a.scaled(a.low), a.scaled(a.high))) for a in self.axes]).reshape(-1, 2)
        return ends[:, 0], ends[:, 1]

    @cached_property
    def told_once(self) -> np.ndarray:
        """Which parameters (p,) one run alone tells: when, and how suddenly, something began that lasts."""
        effects = [_begins_once(choice, axis) for choice in self.hypothesis.effects for axis in effect_axes(choice)]
        return np.array(effects + [False] * len(self.hypothesis.tuned), dtype=bool)

    @property
    def begins(self) -> list[np.ndarray]:
        """Scaled points (p,) at which a search without effects begins: a log may be late by nothing or by all it can.

        Pressures that jump with their command are seen the same at every sample in between.
        """
        nominal = np.zeros(len(self.axes))
        if LATE not in self.hypothesis.tuned:
            return [nominal]
        latest = nominal.copy()
        latest[-1] = self.bounds[1][-1]
        return [nominal, latest]

    def values(self, point: np.ndarray) -> list[float]:
        """Return the physical values at a scaled point (p,)."""
        return [axis.physical(float(u)) for axis, u in zip(self.axes, point, strict=True)]

    def effects(
        self, point: np.ndarray, session: str = "", gone_s: tuple[float, float, float] = NEW
    ) -> tuple[Effect, ...]:
        """Return the effects that act in ``session``, with their parameters at a scaled point.

        ``gone_s`` is how long the run, and for what lasts its session and all sessions, had gone on before.
        """
        gone = dict(zip(("", *LASTING), gone_s, strict=True))
        values, made = iter(self.values(point)), []
        for choice in self.hypothesis.effects:
            mine = [next(values) for _ in effect_axes(choice)]
            if not choice.sessions or session in choice.sessions:
                made.append(build_effect(choice, mine, gone[choice.lasting]))
        return tuple(made)

    def tuned(self, point: np.ndarray) -> dict[str, float]:
        """Return the simulator's parameters at a scaled point."""
        return {name: value for name, value in self._last(point).items() if name != LATE}

    def at_the_end(self, point: np.ndarray) -> list[str]:
        """Return the simulator's parameters that are at an end of their plausible range at a scaled point."""
        tuned = list(zip(self.axes, point, strict=True))[len(self.axes) - len(self.hypothesis.tuned) :]
        ends = ((axis.name, u, AT_END * axis.scaled(axis.low), AT_END * axis.scaled(axis.high)) for axis, u in tuned)
        return [name for name, u, low, high in ends if name != LATE and not low < u < high]

    def late(self, point: np.ndarray) -> float:
        """Return how late the log is at a scaled point, s."""
        return self._last(point).get(LATE, 0.0)

    def _last(self, point: np.ndarray) -> dict[str, float]:
        count = len(self.hypothesis.tuned)
        return dict(zip(self.hypothesis.tuned, self.values(point)[len(self.axes) - count :], strict=True))


@cache
def free_fields(choice: Choice) -> tuple[Any, ...]:
    """Return the fields of one effect's parameters that are free, where its gate opens last of all."""
    effect, gate = effect_class(choice.name), choice.gate
    of_gate = (gate.field, WIDTHS.get(gate.field)) if gate else ()
    found = [f for f in effect.parameter_fields() if f.name not in choice.pinned]
    return (*found, *(f for f in effect.gate_fields() if f.name in of_gate and f.name not in choice.pinned))


@cache
def effect_axes(choice: Choice) -> tuple[Axis, ...]:
    """Return the axes of one effect's free parameters."""
    found = []
    for field in free_fields(choice):
        m = field.metadata
        log = bool(m["log"]) and m["low"] > 0.0
        zero = m["typical"] if log else m["neutral"]
        found.append(Axis(choice.label(), field.name, m["unit"], m["low"], m["high"], zero, m["scale"], log))
    return tuple(found)


def build_effect(choice: Choice, values: Sequence[float], begun_s: float = 0.0) -> Effect:
    """Return the effect with ``values`` in the order of its free parameters, its clock at ``begun_s``."""
    cls = effect_class(choice.name)
    named = pinned_values(choice) | dict(zip((f.name for f in free_fields(choice)), values, strict=True))
    fixed: dict[str, Any] = {"chamber": choice.chamber} if has_chamber(choice.name) else {}
    return cls(**named, **fixed, begun_s=begun_s, before_gauge=choice.before_gauge, behind_gauge=choice.behind_gauge)


def _begins_once(choice: Choice, axis: Axis) -> bool:
    """Return whether ``axis`` says when an effect that lasts began; of a drift all that follows tells that, too."""
    sudden = choice.gate is not None or bool(effect_class(choice.name).onset_of)
    return bool(choice.lasting) and sudden and axis.name in (*MOMENTS, *WIDTHS.values())


def pinned_values(choice: Choice) -> dict[str, float]:
    """Return the neutral values of the parameters that are not free."""
    fields_ = effect_class(choice.name).parameter_fields()
    return {f.name: float(f.metadata["neutral"]) for f in fields_ if f.name in choice.pinned}


def may_be_pinned(choice: Choice) -> list[str]:
    """Return the free parameters whose neutral value means less physics, if there is more than one parameter.

    A time constant or a width with a neutral value inside its range only shapes what another parameter switches on.
    """
    found = [f for f in free_fields(choice) if "gate" not in f.metadata]
    if len(found) < 2 or effect_class(choice.name).together:
        return []
    return [f.name for f in found if not is_essential(choice, f.name)
            and not (f.metadata["log"] and f.metadata["low"] < f.metadata["neutral"] < f.metadata["high"])]  # fmt: skip


def is_essential(choice: Choice, name: str) -> bool:
    """Return whether the effect would be another one if its parameter ``name`` were held at its neutral value too."""
    law = effect_class(choice.name)
    return name in law.essence and (law.undivided or all(other in choice.pinned for other in law.essence if other != name))


def has_chamber(name: str) -> bool:
    """Return whether the effect can act in one chamber alone."""
    return any(field.name == "chamber" for field in fields(effect_class(name)))


def starts(choice: Choice, seen: Sequence[dict[str, float]] = ()) -> list[np.ndarray]:
    """Return scaled points (p,) of an effect that is plain to see: typical values, and spread-out shapes of it.

    ``seen`` are values that were read off the recordings, see ``Effect.seen_in``.
    """
    fields_ = free_fields(choice)
    axes = effect_axes(choice)
    if effect_class(choice.name).together:
        return [neutral(choice)]
    typical = np.array([axis.scaled(field.metadata["typical"]) for axis, field in zip(axes, fields_, strict=True)])
    if choice.gate:
        typical[-1] = axes[-1].scaled(choice.gate.begin)
    found = [typical]
    for k, (axis, field) in enumerate(zip(axes, fields_, strict=True)):
        turned = (-2.1 / axis.scale, 2.1 / axis.scale) if axis.is_direction else ()
        shifts: tuple[float, ...] = (-1.4, 1.4) if axis.log and "gate" not in field.metadata else turned
        if axis.log and field.metadata["neutral"] in (axis.low, axis.high):
            shifts = (-1.0,)
        for shift in shifts:
            moved = typical.copy()
            moved[k] += shift
            found.append(moved)
    for shape in (*effect_class(choice.name).shapes(), *seen):
        named = zip(axes, typical, strict=True)
        found.append(np.array([axis.scaled(shape[axis.name]) if axis.name in shape else u for axis, u in named]))
    low, high = zip(*(sorted((a.scaled(a.low), a.scaled(a.high))) for a in axes), strict=True)
    return [np.clip(point, low, high) for point in found]


def neutral(choice: Choice) -> np.ndarray:
    """Return the scaled point (p,) at which the effect does nothing; a gate stays where a search begins."""
    axes = effect_axes(choice)
    pairs = zip(axes, free_fields(choice), strict=True)
    point = np.array([axis.scaled(field.metadata["neutral"]) for axis, field in pairs])
    if choice.gate:
        point[-1] = axes[-1].scaled(choice.gate.begin)
    return point
