"""Effects in the physical order of their sites, and the plant they make with a body."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numba as nb
import numpy as np
from numba.typed import List

from softrl.core.simulator import Hook, Motion, Simulator
from softrl.effects.effect import SIGNAL_KERNEL, SITES, Effect
from softrl.robots.robot import Robot

_SIGNAL = nb.types.FunctionType(SIGNAL_KERNEL)


@nb.njit(cache=True)
def _filter(kernels: Any, parameters: Any, states: Any, values: np.ndarray, dt: float) -> None:
    """Run every kernel over each row of ``values`` (steps, n), in order, in place."""
    for step in range(len(values)):
        for k in range(len(kernels)):
            kernels[k](parameters[k], states[k], values[step], dt)


@dataclass(frozen=True)
class EffectChain:
    """Effects of one robot, sorted by site: valve, chamber, body, load, sensor; never by list order."""

    robot: Robot
    effects: tuple[Effect, ...] = ()

    @cached_property
    def ordered(self) -> tuple[Effect, ...]:
        """The effects by site; within a site by name, so that a list's order cannot change a result."""
        return tuple(sorted(self.effects, key=lambda e: (SITES.index(e.site), e.name())))

    def at(self, *sites: str) -> tuple[Effect, ...]:
        """Return the effects that act at any of ``sites``."""
        return tuple(e for e in self.ordered if e.site in sites)

    def hooks(self, site: str) -> list[Hook]:
        """Return fresh hooks of the port effects at ``site``, for a body's kernel."""
        return [Hook(type(e).kernel, e.pack(self.robot), e.reset(self.robot)) for e in self.at(site)]

    def filter(self, sites: Sequence[str], values: np.ndarray, dt_s: float) -> np.ndarray:
        """Return ``values`` (steps, n), one row per ``dt_s``, after the signal effects at ``sites``, from rest."""
        return SignalFilter(self, *sites).advance(values, dt_s)


class SignalFilter:
    """The running state of the signal effects at some sites, for stepwise use; ``advance`` continues where it was."""

    def __init__(self, chain: EffectChain, *sites: str) -> None:
        effects = chain.at(*sites)
        self._empty = not effects
        self._kernels = List.empty_list(_SIGNAL)
        self._parameters = List.empty_list(nb.float64[::1])
        self._states = List.empty_list(nb.float64[::1])
        for effect in effects:
            self._kernels.append(type(effect).kernel)
            self._parameters.append(effect.pack(chain.robot))
            self._states.append(effect.reset(chain.robot))

    def advance(self, values: np.ndarray, dt_s: float) -> np.ndarray:
        """Return the filtered rows (steps, n)."""
        filtered = np.array(values, dtype=float, order="C")
        if not self._empty:
            _filter(self._kernels, self._parameters, self._states, filtered, dt_s)
        return filtered


@dataclass(frozen=True)
class Plant:
    """A body with effects around and inside it: what a simulator becomes once physics is added."""

    simulator: Simulator
    chain: EffectChain

    def simulate(self, time: np.ndarray, command: np.ndarray, tip_force: np.ndarray | None = None) -> Motion:
        """Return what the sensors report under ``command`` (steps, chambers) Pa on the uniform grid ``time``.

        ``Motion.pressure`` is the supplied pressure after the valve, as a pressure sensor at the chamber reports it.
        """
        dt_s = float(time[1] - time[0])
        supplied = self.chain.filter(["valve"], command, dt_s)
        acting = self.chain.filter(["chamber"], supplied, dt_s)
        motion = self.simulator.simulate(
            time, acting, tip_force, self.chain.hooks("body"), self.chain.hooks("load")
        )
        pose = self.chain.filter(["sensor"], np.hstack([motion.position, motion.quaternion]), dt_s)
        return replace(motion, position=pose[:, :3], quaternion=pose[:, 3:], pressure=supplied)


def chain_of(robot: Robot, effects: Iterable[Effect]) -> EffectChain:
    """Return the chain of ``effects`` on ``robot``."""
    return EffectChain(robot, tuple(effects))
