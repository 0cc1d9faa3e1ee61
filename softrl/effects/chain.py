"""Effects in the physical order of their sites, and the plant they make with a body."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from softrl.core.errors import ConfigError
from softrl.core.identity import Same
from softrl.core.simulator import Hanging, Hook, Layered, Motion, Simulator, of_steps
from softrl.core.span import Span, after, held
from softrl.effects.call import pack, run_signals
from softrl.effects.effect import SITES, Effect
from softrl.effects.gate import hook_of
from softrl.effects.history import check_reach
from softrl.robots.robot import Robot

# At the valve a source comes before what fills from it: what a regulator is told, makes of that, and has at most. A valve with a
# memory behind it fills towards what there is; before it, it would fill towards what never comes, and vent from there.
SOURCE = ("command_map", "offset", "gain", "supply_limit")


@dataclass(frozen=True)
class EffectChain:
    """Effects of one robot, sorted by site: valve, chamber, body, load, sensor; never by list order.

    ``effects`` are the parts of those that are given, so that each acts at one site.
    """

    robot: Robot
    effects: tuple[Effect, ...] = ()
    before_s: float = 0.0  # how long a run goes on before its first sample, at which the effects' clocks stand at zero
    temperature: np.ndarray | None = field(default=None, compare=False)  # degree Celsius, one a second from there on
    retuned: bool = False  # whether the body that they surround has the parameters that a diagnosis found

    def __post_init__(self) -> None:
        object.__setattr__(self, "effects", tuple(part for effect in self.effects for part in effect.parts()))

    @property
    def corrected(self) -> bool:
        """Whether the simulator is another than the nominal one: it takes the robot's own pressures then, and no f_RS."""
        return bool(self.effects) or self.retuned

    @cached_property
    def ordered(self) -> tuple[Effect, ...]:
        """The effects by site; within a site by name, so that a list's order cannot change a result.

        At the valve its source comes first, see ``SOURCE``. In chambers what belongs to valves comes first, and areas after
        all that changes the pressure on them.
        """
        return tuple(sorted(self.effects, key=_place))

    @cached_property
    def _at(self) -> dict[tuple[str, ...], tuple[Effect, ...]]:
        """What ``at`` found before."""
        return {}

    def at(self, *sites: str) -> tuple[Effect, ...]:
        """Return the effects that act at any of ``sites``."""
        if sites not in self._at:
            self._at[sites] = tuple(e for e in self.ordered if e.acts_at in sites)
        return self._at[sites]

    @property
    def gauges(self) -> tuple[Effect, ...]:
        """The effects on the reported pressures; the site "sensor" of a ``SignalFilter`` means the others, on the pose."""
        return tuple(e for e in self.at("sensor") if e.channel == "pressure")

    def reported(self, pressure: Span, dt_s: float) -> np.ndarray:
        """Return what the pressure sensors report (steps, chambers) Pa of ``pressure`` at the steps' ends, from rest."""
        return SignalFilter(self, "gauge").lead(pressure, dt_s).end

    def hooks(self, site: str) -> list[Hook]:
        """Return fresh hooks of the port effects at ``site``, for a body's kernel."""
        return [hook_of(e, self.robot, self.before_s, self.temperature) for e in self.at(site) if not e.layered]

    def body(self, simulator: Simulator) -> Simulator:
        """Return ``simulator`` with its layers as stiff as the effects make them.

        Raises
        ------
        ConfigError
            If an effect asks for layers of a body that has none.
        """
        inside = [e for e in self.ordered if e.layered]
        if not inside:
            return simulator
        if not isinstance(simulator, Layered):
            raise ConfigError(
                f"effect {inside[0].name()} needs a body with layers, which {type(simulator).__name__} has not; "
                "expected simulator=rom or fem"
            )
        scales = np.prod([e.layers(simulator.layers) for e in inside], axis=0)
        return _with_layers(Same(simulator), *map(float, scales))

    def at_rest(self, simulator: Simulator, load: Sequence[Hook]) -> Any:
        """Return the state from which ``simulator`` steps: at rest under the ``load`` hooks, as ``simulate`` begins.

        Their states are brought there, and no time passes for them: a run's first step is the first of their clocks.
        """
        return simulator.at_rest(load) if isinstance(simulator, Hanging) else simulator.reset()  # the others take no hooks

    def supplied(self, command: Span, dt_s: float) -> Span:
        """Return the pressures behind the valves under ``command``, one row per ``dt_s``, from rest."""
        return SignalFilter(self, "valve").lead(command, dt_s)

    def acting(self, supplied: Span, dt_s: float) -> Span:
        """Return what acts of the ``supplied`` pressures, from rest."""
        return SignalFilter(self, "chamber").lead(supplied, dt_s)

    def stood_under(self, command: np.ndarray, shown: np.ndarray, rows: int, dt_s: float) -> np.ndarray:
        """Return the pressures (chambers,) Pa before the valve for ``rows``, where its gauges have ``shown`` (chambers,) then.

        They are the ``command`` (chambers,), and what is shown beyond what the valve has made of that: a valve at rest stood
        under its command whatever it makes of it, one on its way under about where it has got to.
        """
        rest = self.supplied(held(np.tile(command, (rows, 1))), dt_s)
        return np.asarray(command + shown - self.reported(rest, dt_s)[-1])


def _place(effect: Effect) -> tuple[Any, ...]:
    """Return what effects are sorted by; of one name by their fields, for what they do in two chambers need not commute."""
    of_source = effect.acts_at == "valve" and effect.name() in SOURCE
    source = SOURCE.index(effect.name()) if of_source else len(SOURCE)
    return SITES.index(effect.acts_at), source, SITES.index(effect.site), effect.of_area, effect.name(), *vars(effect).values()


@lru_cache(maxsize=64)
def _with_layers(body: Same[Layered], *scales: float) -> Simulator:
    """Return a body with other layers, made once for all runs."""
    return body.thing.with_layers(scales)


class SignalFilter:
    """The running state of the signal effects at some sites, for stepwise use; ``advance`` and ``lead`` go on where they were.

    The site "sensor" means effects on the pose; "gauge" those on the reported pressures.
    """

    def __init__(self, chain: EffectChain, *sites: str) -> None:
        effects = [e for e in chain.at(*sites) if e.channel == "pose"]
        effects += chain.gauges if "gauge" in sites else ()
        self._delays = [(e.name(), e.delay_s) for e in effects if hasattr(e, "delay_s")]
        self._calls = pack([hook_of(e, chain.robot, chain.before_s, chain.temperature) for e in effects]) if effects else None
        self._flows = np.array([e.flows for e in effects], dtype=np.bool_)

    @property
    def memory(self) -> np.ndarray:
        """All that it remembers (k,), the array itself: it goes on from what is written there."""
        return np.zeros(0) if self._calls is None else self._calls.states

    def advance(self, values: np.ndarray, dt_s: float) -> np.ndarray:
        """Return the filtered poses (steps, n) at the steps' ends; raise what ``lead`` does."""
        return self.lead(held(values), dt_s).end

    def lead(self, pressure: Span, dt_s: float) -> Span:
        """Return the filtered pressures.

        Raises
        ------
        ConfigError
            If the steps are too short for a delay.
        """
        for name, delay_s in self._delays:
            check_reach(name, delay_s, dt_s)
        mean, apart = np.array(pressure.mean, dtype=float, order="C"), pressure.end is not pressure.mean
        end = np.array(pressure.end, dtype=float, order="C") if apart else np.empty_like(mean)
        if self._calls is not None:
            apart = run_signals(self._calls, self._flows, mean, end, apart, dt_s)
        return Span(mean, end if apart else mean)


@dataclass(frozen=True)
class Plant:
    """A body with effects around and inside it: what a simulator becomes once physics is added."""

    simulator: Simulator
    chain: EffectChain

    def simulate(self, time: np.ndarray, command: np.ndarray, tip_force: np.ndarray | None = None) -> Motion:
        """Return what the sensors report under ``command`` (steps, chambers) Pa on the uniform grid ``time``.

        ``Motion.pressure`` is the supplied pressure after the valve, as a pressure sensor at the chamber reports it.
        """
        return simulate_batch([self], time, command, tip_force)[0]

    def _behind_valve(self, time: np.ndarray, supplied: Span, acting: Span, tip_force: Span | None) -> Motion:
        """Return what the sensors report of a body on which ``acting`` acts."""
        body = self.chain.body(self.simulator)
        force = None if tip_force is None else of_steps(body, tip_force)
        motion = body.simulate(time, of_steps(body, acting), force, self.chain.hooks("body"), self.chain.hooks("load"))
        shown = self.chain.reported(supplied, float(time[1] - time[0]))
        if all(effect.channel == "pressure" for effect in self.chain.at("sensor")):
            return replace(motion, pressure=shown)
        pose = np.hstack([motion.position, motion.quaternion])
        pose = SignalFilter(self.chain, "sensor").advance(pose, float(time[1] - time[0]))
        return replace(motion, position=pose[:, :3], quaternion=pose[:, 3:], pressure=shown)


def simulate_batch(
    plants: Sequence[Plant],
    time: np.ndarray,
    command: np.ndarray | Span,
    tip_force: np.ndarray | Span | None = None,
    workers: int = 1,
    before: np.ndarray | None = None,
    shown: tuple[int, np.ndarray] | None = None,
) -> list[Motion]:
    """Return what ``plant.simulate(time, command, tip_force)`` returns for every plant, to the last bit.

    Parameters
    ----------
    plants : of one robot; parameters of body and effects vary, as the columns of a Jacobian or the points of a
        search do. The effects may differ too.
    time : (steps,) s, uniform
    command : (steps, chambers) Pa, held over each step, or known as it changes
    tip_force : (steps, 3) N likewise, or None
    workers : threads; they share the work only while the simulator's kernel runs without the interpreter's lock, as
        that of the lumped body does
    before : (rows, chambers) Pa that act in the chambers during the first rows, whatever the valve supplies then
    shown : how many rows come before the first sample, and what gauges (chambers,) Pa showed there, see ``stood_under``

    Notes
    -----
    Plants whose effects at valve and chamber are equal share one filtering of the command, so that varying the body
    costs nothing there. The bodies run one after the other in compiled code.
    """
    dt_s, command, force = float(time[1] - time[0]), held(command), None if tip_force is None else held(tip_force)
    supply: dict[tuple[Effect, ...], Span] = {}
    acting: dict[tuple[Effect, ...], Span] = {}

    def shared_by(chain: EffectChain) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
        """Return the effects on which the supply depends, and those on which what acts does."""
        valve = chain.at("valve") if shown is None else chain.at("valve") + chain.gauges
        return valve, valve + chain.at("chamber")

    for plant in plants:
        valve, both = shared_by(plant.chain)
        if valve not in supply:
            supply[valve] = plant.chain.supplied(_begun(plant.chain, command, dt_s, shown), dt_s)
        if both not in acting:
            let_in = supply[valve] if before is None else after(before, supply[valve])
            acting[both] = plant.chain.acting(let_in, dt_s)

    def simulated(plant: Plant) -> Motion:
        valve, both = shared_by(plant.chain)
        return plant._behind_valve(time, supply[valve], acting[both], force)

    if workers < 2 or len(plants) < 2:
        return [simulated(plant) for plant in plants]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(simulated, plants))


def _begun(chain: EffectChain, command: Span, dt_s: float, shown: tuple[int, np.ndarray] | None) -> Span:
    """Return ``command`` with what stood before the valve in the rows before the first sample."""
    if shown is None or not shown[0]:
        return command
    rows, pressure = shown
    stood = chain.stood_under(command.mean[0], pressure, rows, dt_s)
    return after(np.tile(stood, (rows, 1)), command)


def chain_of(robot: Robot, effects: Iterable[Effect]) -> EffectChain:
    """Return the chain of ``effects`` on ``robot``."""
    return EffectChain(robot, tuple(effects))
