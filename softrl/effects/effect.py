"""The contract of an effect: one piece of physics that a simulator may leave out.

Two kinds of kernel, both numba functions without the interpreter in the loop:

* a *signal* kernel (sites valve, chamber, sensor) changes a vector in place once per time step:
  ``kernel(parameters, state, value, dt)``. At valve and chamber the value is the chambers' mean pressure over the step in Pa,
  before and after, so that what fills slowly acts on a body when it does. With a ``dt`` of 0 no time passes, and the value
  becomes what there is at that moment. At the sensor it is the pose at the step's end, position (3) m and quaternion (4)
  w x y z, or (``channel = "pressure"``) the reported pressures, mean and then end.
* a *port* kernel (sites body, load) acts inside the body's implicit step:
  ``kernel(parameters, state, port, dt, commit)``. It reads the trial motion from ``port`` and *adds* its reaction and
  the derivative of that reaction; it may change ``state`` only when ``commit`` is true, once a step has converged.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numba as nb
import numpy as np

from softrl.core.errors import ConfigError
from softrl.core.span import Span
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot

SITES = ("valve", "chamber", "body", "load", "sensor")

_vector = nb.types.Array(nb.float64, 1, "C")
_matrix = nb.types.Array(nb.float64, 2, "C")
SIGNAL_KERNEL = nb.void(_vector, _vector, _vector, nb.float64)
PORT_KERNEL = nb.void(_vector, _vector, _matrix, nb.float64, nb.boolean)

ANY_MOMENT_S = 3.2e7  # a year: what goes on from run to run may begin after as long a pause, and no recordings take longer
EVERYWHERE = -1.0  # as ``above_share``: no pressure is below it
TURN = 2.0 * math.pi  # rad, either way: bounds of a direction, so that a search may pass where it would jump
STAGE = 1.0 - math.sqrt(0.5)  # share of a step after which bodies whose steps have two stages ask, besides its end


def parameter(
    unit: str,
    low: float,
    high: float,
    neutral: float,
    *,
    typical: float,
    log: bool = False,
    scale: float | None = None,
    default: Any = dataclasses.MISSING,
    of: str = "",
) -> Any:
    """Declare a fitted parameter of an effect.

    Parameters
    ----------
    unit : SI unit, "1" if dimensionless
    low, high : hard bounds of the search; ``neutral`` lies within them
    neutral : the value at which the effect vanishes
    typical : a value at which the effect is plain to see; the prior's scale
    log : search on a logarithmic scale (only where low > 0)
    scale : a change that is plain to see, where it is not what leads from ``neutral`` to ``typical``
    default : the value where none is given; must be given if this is missing
    of : of what of the robot's it is a share: "pressure" (the largest in size), "ceiling" (the highest), "length" or "mass"; or
        empty
    """
    metadata = {"unit": unit, "low": low, "high": high, "neutral": neutral, "typical": typical, "log": log, "of": of}
    metadata["scale"] = scale or abs(typical - neutral) or 0.1 * (high - low)
    return dataclasses.field(default=default, metadata=metadata)


def _gate(unit: str, low: float, high: float, typical: float, log: bool = False) -> dict[str, Any]:
    """Return what is known of a number of the gate; it is neutral at ``low``, or where ``log`` as good as typical."""
    neutral = typical if log else low
    known = {"unit": unit, "low": low, "high": high, "neutral": neutral, "typical": typical, "log": log, "gate": True}
    return known | {"scale": typical - low, "of": "pressure" if unit == "1" else ""}


@dataclass(frozen=True)
class Effect:
    """Base of all effects: a subclass adds parameters with ``parameter(...)``, a site, and a kernel.

    Every subclass has a field ``chamber``, or none: -1 for all chambers, else one chamber's number from 0. Every effect may
    be told to act only from a time on, and where pressures are only above one, see ``effects.gate``.

    Attributes
    ----------
    site : where it acts, one of ``SITES``
    channel : of a sensor effect, what it changes: "pose", or "pressure" for the reported chamber pressures
    variant_of : name of the effect whose physics this one describes by another law, or empty
    extends : name of the effect whose law is a limit of this one's: where both fit alike that one is meant, or empty
    together : whether its parameters mean something together only, so that none is tried without the others
    exact : whether its law has no other form: a turned frame explains nearly all where it acts, a wall's law may not
    sized : whether half of its first parameter is half of the effect; half the period of a slow sensor is another sensor
    clock : slot of the state that counts the seconds since the first sample, if there is one
    lasts : whether what its clock has brought about may stay from run to run: its clock then goes on, see ``begun_s``
    shifts_time : whether all that it does is to let everything happen later
    retunes : whether all that it does, everywhere and always, is what another value of a simulator's parameters does
    sticks : whether a small change and its taking back leave something behind, as dry friction does
    flows : whether what it gives changes within a step in which what it is given is held
    gauged : whether a chamber's effect may lie before the gauge of its pressure as well as behind it, see ``before_gauge``
    piped : whether a valve's effect may be that of the line from the gauge to the chamber as well, see ``behind_gauge``
    of_area : whether a chamber's effect is that of the area on which its pressure acts, after all that changes the pressure
    needs : channel of a recording whose course it follows, "temperature", without which it does nothing; or empty
    contains : names of the effects that this one is where its ``essence`` is neutral: where it does no better it is that one
    essence : names of the parameters without all of which it is another effect: never are all held at their neutral values
    undivided : whether it is another effect without any one of its ``essence``: none is held at its neutral value
    twins : two groups of parameters that say the same with all values exchanged: what acts alone is told as the first, or none
    onset_of : name of the effect that this one is where that begins in a moment, or empty: a failed chamber has a smaller gain
    sudden : whether it may begin from one moment to the next: a camera is knocked rather than a robot's mount
    above_own : whether it acts above a pressure of its own only, and so in no need of a gate that says one
    layered : whether it changes the layers of the body itself, before anything moves: it has ``layers`` in place of a kernel,
        and no gate
    stores : whether its first parameter is a flow into a store of each chamber's, which stays when a gate stops the flow
    before_gauge : whether an effect on chambers acts before their pressures are measured, at the valve, so that gauges show it
    begun_s : how long the clock of what ``lasts``, and that of ``since_s``, had gone on already at the first sample of a run, s
    behind_gauge : whether an effect of valves lies between where pressures are measured and the chambers: gauges do not show it
    above_share : share of the robot's largest pressure above which it acts; ``EVERYWHERE`` for all pressures
    over_s : how long it takes from ``since_s`` until it acts in full, s: a camera is knocked in a moment, a leak tears open
    since_s : time of each run from which it acts, s; 0 for always
    """

    site: ClassVar[str]
    title: ClassVar[str]
    kernel: ClassVar[Any] = None
    channel: ClassVar[str] = "pose"
    variant_of: ClassVar[str] = ""
    extends: ClassVar[str] = ""
    together: ClassVar[bool] = False
    exact: ClassVar[bool] = False
    sized: ClassVar[bool] = True
    clock: ClassVar[int | None] = None
    lasts: ClassVar[bool] = False
    shifts_time: ClassVar[bool] = False
    retunes: ClassVar[bool] = False
    sticks: ClassVar[bool] = False
    stores: ClassVar[bool] = False
    flows: ClassVar[bool] = False
    gauged: ClassVar[bool] = False
    piped: ClassVar[bool] = False
    of_area: ClassVar[bool] = False
    needs: ClassVar[str] = ""
    contains: ClassVar[tuple[str, ...]] = ()
    essence: ClassVar[tuple[str, ...]] = ()
    undivided: ClassVar[bool] = False
    twins: ClassVar[tuple[tuple[str, ...], ...]] = ()
    onset_of: ClassVar[str] = ""
    sudden: ClassVar[bool] = True
    above_own: ClassVar[bool] = False
    layered: ClassVar[bool] = False

    above_share: float = dataclasses.field(default=EVERYWHERE, kw_only=True, metadata=_gate("1", EVERYWHERE, 1.0, 0.3))
    over_s: float = dataclasses.field(default=1.0, kw_only=True, metadata=_gate("s", 0.05, 20.0, 1.0, log=True))
    since_s: float = dataclasses.field(default=0.0, kw_only=True, metadata=_gate("s", 0.0, ANY_MOMENT_S, 10.0))
    begun_s: float = dataclasses.field(default=0.0, kw_only=True)
    before_gauge: bool = dataclasses.field(default=False, kw_only=True)
    behind_gauge: bool = dataclasses.field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        for field in (*self.parameter_fields(), *self.gate_fields()):
            value, low, high = getattr(self, field.name), field.metadata["low"], field.metadata["high"]
            if not low <= value <= high:
                unit = "" if field.metadata["unit"] == "1" else f" {field.metadata['unit']}"
                raise ConfigError(f"effect {self.name()}.{field.name}={value:g}{unit} is outside {low:g}..{high:g}")
        if self.before_gauge and not self.gauged:
            raise ConfigError(f"effect {self.name()}.before_gauge=true: no gauge of a chamber's pressure can show it")
        if self.behind_gauge and not self.piped:
            raise ConfigError(f"effect {self.name()}.behind_gauge=true: it is not that of a line from a gauge to a chamber")
        if self.layered and self.gated:
            raise ConfigError(f"effect {self.name()} is how the body is made; expected neither above_share nor since_s")
        if self.above_share > EVERYWHERE and not self.under_pressure():
            raise ConfigError(f"effect {self.name()}.above_share={self.above_share:g}: no pressure acts there; expected since_s")

    @classmethod
    def name(cls) -> str:
        """Return the file and config name of this effect."""
        return cls.__module__.rsplit(".", 1)[-1]

    @classmethod
    def parameter_fields(cls) -> Iterator[dataclasses.Field[Any]]:
        """Yield the fitted fields in order, without those of the gate."""
        return (field for field in fields(cls) if "unit" in field.metadata and "gate" not in field.metadata)

    @classmethod
    def gate_fields(cls) -> Iterator[dataclasses.Field[Any]]:
        """Yield the fields that say above which pressure and from when on it acts."""
        return (field for field in fields(cls) if "gate" in field.metadata)

    @classmethod
    def under_pressure(cls) -> bool:
        """Return whether it acts where pressures are, so that it may act above one only."""
        return cls.site in ("valve", "chamber", "body") or (cls.site == "sensor" and cls.channel == "pressure")

    @property
    def acts_at(self) -> str:
        """Where along the pipeline it acts, one of ``SITES``."""
        return "valve" if self.before_gauge else "chamber" if self.behind_gauge else self.site

    @property
    def gated(self) -> bool:
        """Whether it acts above a pressure, or from a time on, only."""
        return self.above_share > EVERYWHERE or self.since_s > 0.0

    @classmethod
    def neutral(cls, **fixed: Any) -> "Effect":
        """Return this effect with the parameters at which it does nothing; ``fixed`` sets the other fields."""
        return cls(**{f.name: f.metadata["neutral"] for f in cls.parameter_fields()}, **fixed)

    @classmethod
    def suits(cls, robot: Robot) -> bool:
        """Return whether the effect makes sense for ``robot``."""
        return True

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return values beside the typical ones from which a fit may begin, where those lead to one shape out of many."""
        return []

    @classmethod
    def seen_in(cls, runs: Sequence[Recording], longest_s: float) -> list[dict[str, float]]:
        """Return values that can be read off recordings, where a fit has no slope that leads there.

        ``longest_s`` is the longest that the effect's clock goes on.
        """
        return []

    def pack(self, robot: Robot) -> np.ndarray:
        """Return the parameter vector that the kernel reads; by default the fitted fields, then ``chamber``."""
        if not -1 <= getattr(self, "chamber", -1) < robot.chambers:
            raise ConfigError(
                f"effect {self.name()}.chamber={getattr(self, 'chamber', -1)} does not exist; "
                f"robot {robot.name} has chambers 0..{robot.chambers - 1}, and -1 means all"
            )
        values = [float(getattr(self, field.name)) for field in self.parameter_fields()]
        return np.array([*values, float(getattr(self, "chamber", -1))])

    def reset(self, robot: Robot) -> np.ndarray:
        """Return the state vector at rest; one or more slots, as the kernel needs."""
        return np.zeros(max(robot.chambers, 1))

    def unrelaxed(self, after_s: float) -> float:
        """Return what the wall still resists besides ``after_s`` of a hold, as a share of what it does at long last."""
        return 0.0

    def parts(self) -> tuple["Effect", ...]:
        """Return the effects at single sites that this one is made of: itself, unless it acts at several."""
        return (self,)

    def undo(self, robot: Robot, reported: Span, share: np.ndarray, dt_s: float) -> Span:
        """Return the pressures behind what a gauge ``reported``; of its error ``share`` (steps, 1) acts."""
        raise NotImplementedError(f"effect {self.name()} does not act on a pressure sensor")

    @property
    def told_as(self) -> str:
        """Name of the effect that this one is with its present numbers, told by another law; empty if it is none but itself."""
        return ""

    def layers(self, count: int) -> np.ndarray:
        """Return the factors (count,) on the stiffness of the body's layers, from below."""
        raise NotImplementedError(f"effect {self.name()} does not act on layers")

    def apply(self, robot: Robot, state: np.ndarray, value: np.ndarray, dt_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return (state, value) after one step, inputs untouched: the pure form of a kernel call."""
        state, value = state.copy(), np.array(value, dtype=float)
        if self.site in ("body", "load"):
            type(self).kernel(self.pack(robot), state, value, dt_s, True)
        else:
            type(self).kernel(self.pack(robot), state, value, dt_s)
        return state, value
