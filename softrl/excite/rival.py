"""A hypothesis whose parameters are free: what a program shall tell from another one."""

import math
import re
from collections.abc import Sequence
from dataclasses import Field, dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.errors import ConfigError
from softrl.core.simulator import Simulator
from softrl.effects.chain import Plant, chain_of
from softrl.effects.dead_time import DeadTime
from softrl.effects.effect import Effect
from softrl.effects.library import effect_class
from softrl.excite.form import Form, form_of, form_of_label
from softrl.robots.robot import Robot

NOTHING = "nothing"  # the hypothesis that only the simulator's parameters are off
BODY, LOG = -1, -2  # owners of free parameters beside the effects
SHAPES = {  # parameters that say how an effect acts, not how much: with more of it they stay
    "play": ("spread",),
    "pressure_play": ("spread",),
    "crosstalk": ("lean",),
    "tube_line": ("damping_ratio",),
}


class Axis(NamedTuple):
    """One free parameter: ``effect`` is its place in the rival's list, ``BODY`` the simulator's own, ``LOG`` the log's."""

    effect: int
    name: str
    low: float
    high: float
    zero: float
    scale: float
    log: bool

    def scaled(self, value: float) -> float:
        """Return the coordinate u of a value, about 1 where the effect is plain to see."""
        return math.log(value / self.zero) / self.scale if self.log else (value - self.zero) / self.scale

    def physical(self, u: float) -> float:
        """Return the value at u, within the bounds."""
        value = self.zero * math.exp(self.scale * u) if self.log else self.zero + self.scale * u
        return min(max(value, self.low), self.high)


@dataclass(frozen=True)
class Rival:
    """Effects on a simulator, all parameters of both free.

    Attributes
    ----------
    label : how the rival is called in results
    simulator : at its nominal parameters
    effects : at the parameters from which searches begin
    tuned_factor : the simulator's parameters may change by this factor either way
    late_max_s : how long after its time a row may act, as logs have it: a diagnosis takes that for no physics
    """

    label: str
    robot: Robot
    simulator: Simulator
    effects: tuple[Effect, ...]
    tuned_factor: float
    late_max_s: float = 0.0

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The free parameters: effects' in order, then the simulator's, and the log's where no effect delays all there is."""
        found = [axis for k, effect in enumerate(self.effects) for axis in _axes_of(k, effect)]
        spread = math.log(self.tuned_factor)
        for name, value in self.simulator.parameters.items():
            found.append(
                Axis(BODY, name, value / self.tuned_factor, value * self.tuned_factor, value, 0.5 * spread, True)
            )
        delayed = any(e.shifts_time and getattr(e, "chamber", -1) < 0 and not e.gated for e in self.effects)
        if self.late_max_s > 0.0 and not delayed:
            found.append(Axis(LOG, "late_s", 0.0, self.late_max_s, 0.0, self.late_max_s, False))
        return tuple(found)

    @property
    def point(self) -> np.ndarray:
        """The scaled parameters (p,) at which the rival stands."""
        # from an end of its range a search hardly sets out
        values = {BODY: self.simulator.parameters, LOG: {"late_s": 0.5 * self.late_max_s}}
        return np.array(
            [
                axis.scaled(values[axis.effect][axis.name] if axis.effect < 0 else getattr(self.effects[axis.effect], axis.name))
                for axis in self.axes
            ]
        )

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest scaled point (p,)."""
        ends = np.array([sorted((a.scaled(a.low), a.scaled(a.high))) for a in self.axes])
        return ends[:, 0], ends[:, 1]

    def at(self, point: np.ndarray) -> Plant:
        """Return the plant at a scaled point (p,)."""
        changed: dict[int, dict[str, float]] = {k: {} for k in (BODY, LOG, *range(len(self.effects)))}
        for axis, u in zip(self.axes, point, strict=True):
            changed[axis.effect][axis.name] = axis.physical(float(u))
        effects = [replace(effect, **changed[k]) for k, effect in enumerate(self.effects)]
        effects += [DeadTime(delay_s=late) for late in changed[LOG].values()]
        return Plant(self.simulator.with_parameters(**changed[BODY]), chain_of(self.robot, effects))


def _axes_of(number: int, effect: Effect) -> list[Axis]:
    found = []
    for field in effect.parameter_fields():
        m = field.metadata
        log = bool(m["log"])
        scale = 1.0 if log else abs(m["typical"] - m["neutral"]) or 0.1 * (m["high"] - m["low"])
        zero = m["typical"] if log else m["neutral"]
        found.append(Axis(number, field.name, m["low"], m["high"], zero, scale, log))
    return found


def parse(text: str, robot: Robot, size: float = 1.0) -> tuple[Effect, ...]:
    """Return the typical effects of a hypothesis such as ``lag+payload``, ``gain@2`` (chamber 2) or ``nothing``.

    Raises
    ------
    ConfigError
        If an effect is unknown, makes no sense for the robot, has no such chamber, or is not to be had in such a size.
    """
    return tuple(typical(name, robot, size) for name in text.split("+") if name.strip() != NOTHING)


def typical(name: str, robot: Robot, size: float = 1.0) -> Effect:
    """Return the effect ``name``, or ``name@chamber`` counted from 1, at ``size`` of its typical strength."""
    match = re.fullmatch(r"\s*(\w+?)\s*(?:@\s*(\d+)|\(chamber (\d+)\))?\s*", name)
    if match is None:
        raise ConfigError(
            f"stage.hypotheses: '{name}' cannot be read; expected an effect's name, with @ and a chamber's number if "
            "it acts in one alone, and + between effects that act together"
        )
    cls, number = effect_class(match[1]), match[2] or match[3]
    if not cls.suits(robot) or cls.needs:
        why = f"it follows the {cls.needs}, which no program moves" if cls.needs else f"it makes no sense for robot {robot.name}"
        raise ConfigError(f"stage.hypotheses: '{name}' would do nothing here: {why}; leave it out")
    values: dict[str, Any] = {f.name: _sized(match[1], f, size) for f in cls.parameter_fields()}
    if number is not None:
        if not any(field.name == "chamber" for field in fields(cls)) or not 1 <= int(number) <= robot.chambers:
            raise ConfigError(
                f"stage.hypotheses: '{name}' does not exist; robot {robot.name} has chambers 1..{robot.chambers}, "
                "and not every effect can act in one alone"
            )
        values["chamber"] = int(number) - 1
    return cls(**values)


def _sized(effect: str, field: Field[Any], size: float) -> float:
    """Return a parameter at ``size`` of its typical strength; one of shape as it is typical.

    A rate that does nothing at the end of its range, as one without limit does, is by so much nearer to it or farther.

    Raises
    ------
    ConfigError
        If that is outside the parameter's range.
    """
    m = field.metadata
    if field.name in SHAPES.get(effect, ()):
        return float(m["typical"])
    if not m["log"]:
        value = m["neutral"] + size * (m["typical"] - m["neutral"])
    elif m["neutral"] in (m["low"], m["high"]) and m["neutral"] != m["typical"]:
        value = m["typical"] * (size if m["neutral"] == m["low"] else 1.0 / size)
    else:
        value = m["typical"]
    if not m["low"] <= value <= m["high"]:
        nearer = "smaller" if size > 1.0 else "larger"
        raise ConfigError(
            f"stage.size={size:g} makes {effect}.{field.name}={value:g}, outside {m['low']:g}..{m['high']:g}; "
            f"expected a {nearer} size"
        )
    return float(value)


def rivals_of(
    hypotheses: Sequence[str],
    diagnosis: Diagnosis | None,
    robot: Robot,
    simulator: Simulator,
    tuned_factor: float,
    size: float = 1.0,
    late_max_s: float = 0.0,
) -> list[Rival]:
    """Return the rivals that were listed, or else those that a diagnosis left open; their logs may be late.

    Raises
    ------
    ConfigError
        If there are fewer than two.
    """
    if hypotheses:
        found = [Rival(text, robot, simulator, parse(text, robot, size), tuned_factor) for text in hypotheses]
    elif diagnosis is not None:
        found = _open_in(diagnosis, robot, simulator, tuned_factor)
    else:
        raise ConfigError(
            "stage.hypotheses=[] and there is no diagnosis; expected two effects or more, such as "
            "stage.hypotheses=[hysteresis,viscoelasticity], or inputs.diagnosis=run:<id>"
        )
    if len({rival.label for rival in found}) < 2:
        raise ConfigError(
            f"stage.hypotheses={[rival.label for rival in found]}: nothing to tell apart; expected two or more that differ"
        )
    return list({rival.label: replace(rival, late_max_s=late_max_s) for rival in found}.values())


def _open_in(diagnosis: Diagnosis, robot: Robot, simulator: Simulator, factor: float) -> list[Rival]:
    """Return the hypothesis that a diagnosis named, and it with each effect replaced by an equivalent rival.

    They are told apart by what is recorded from now on: what is history does nothing there, and of hypotheses that do the same
    the first is enough.
    """
    tuned = diagnosis.simulator_parameters
    if diagnosis.simulator_name != type(simulator).__name__:
        tuned = {name: value for name, value in tuned.items() if name in simulator.parameters}
    body = simulator.with_parameters(**tuned)
    named = [form_of(entry) for entry in diagnosis.effects]
    open_: dict[tuple[Effect, ...], str] = {_built(named): "+".join(_labels(named)) or NOTHING}
    for row in diagnosis.rivals:
        gone = form_of(row["replaces"]) if "replaces" in row else form_of_label(row["instead_of"])
        place = next((k for k, form in enumerate(named) if form.same_as(gone)), None)
        if not row.get("contests", row["equivalent"]) or place is None:
            continue
        rival = form_of(row["effect"]) if "effect" in row else form_of_label(row["name"])
        before, after = named[:place], named[place + 1 :]
        labels = [*_labels(before), row["name"], *_labels(after)]
        open_.setdefault(_built([*before, rival, *after]), "+".join(labels))
    if len(open_) < 2:
        listed = "+".join(form.listed for form in named if not form.past) or "lag"
        raise ConfigError(
            f"inputs.diagnosis ({diagnosis.verdict}) leaves no two hypotheses open; list them, for example "
            f"stage.hypotheses=[{listed},{NOTHING}]"
        )
    return [Rival(label, robot, body, effects, factor) for effects, label in open_.items()]


def _labels(forms: Sequence[Form]) -> list[str]:
    return [form.label for form in forms if not form.past]


def _built(forms: Sequence[Form]) -> tuple[Effect, ...]:
    return tuple(form.build() for form in forms if not form.past)
