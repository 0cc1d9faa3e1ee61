"""A simulator with its effects in motion, one request after the other: what a policy acts on where the plant has a memory."""

from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from softrl.core.simulator import of_steps
from softrl.core.span import Span, held
from softrl.effects.chain import SignalFilter
from softrl.pcc.simulator import PccSimulator
from softrl.pod.simulator import RomSimulator
from softrl.rl.filter import MovingAverage
from softrl.rl.inversion import Route

FAST = RomSimulator | PccSimulator  # they go over many steps in one call


class _Moment(NamedTuple):
    """All that a run goes on from."""

    state: Any
    sent: np.ndarray
    tip: np.ndarray
    average: MovingAverage
    memories: list[np.ndarray]


class Run:
    """One robot behind a route, from rest; ``Route.predict`` says the same of a sequence that is known as a whole.

    Parameters
    ----------
    tip_force : (3,) N, acts from the first period on; none if None
    """

    def __init__(self, route: Route, tip_force: np.ndarray | None = None) -> None:
        self._route, self._chain = route, route.plant.chain
        self._body = self._chain.body(route.plant.simulator)
        self._valve, self._chamber, self._sensor = (SignalFilter(self._chain, s) for s in ("valve", "chamber", "sensor"))
        self._sensed = any(effect.channel == "pose" for effect in self._chain.at("sensor"))
        self._average = MovingAverage(route.average_window)
        self._sent = np.zeros(route.robot.chambers)
        self._hooks = self._chain.hooks("body"), self._chain.hooks("load")
        self._state = self._chain.at_rest(self._body, self._hooks[1])
        self._force = None if tip_force is None else np.asarray(tip_force, dtype=float)
        self.tip = self._held(np.tile(self._sent, (route.hold, 1)))
        self._before: tuple[_Moment, np.ndarray] | None = None

    def advance(self, request: np.ndarray, measured: Span | None = None) -> np.ndarray:
        """Return the tip (3,) m at the end of the period of ``request`` (n,) Pa.

        ``measured`` (hold, n) Pa stands behind the valves of those chambers where it is a number, whatever they are told.
        """
        self._before = self._moment(), request
        command = self._route.sent(self._sent, self._average.advance(request))
        self._sent = command[-1]
        self.tip = self._held(command, measured)
        return self.tip

    def amend(self, measured: Span) -> np.ndarray:
        """Return the tip (3,) m after the last period, had ``measured`` (hold, n) Pa stood behind the valves in it."""
        if self._before is None:
            return self.tip
        before, request = self._before
        self._resume(before)
        return self.advance(request, measured)

    def foresee(self, requests: np.ndarray) -> np.ndarray:
        """Return the tips (steps, 3) m at the ends of the periods of ``requests`` (steps, n) Pa, and stay where it is."""
        kept, last = self._moment(), self._before
        tips = np.stack([self.advance(request) for request in requests])
        self._resume(kept)
        self._before = last
        return tips

    def _memories(self) -> list[np.ndarray]:
        """Return the arrays in which the effects remember, which go on from what is written there."""
        filters = [f.memory for f in (self._valve, self._chamber, self._sensor)]
        return filters + [hook.state for hooks in self._hooks for hook in hooks]

    def _moment(self) -> "_Moment":
        return _Moment(
            self._state, self._sent, self.tip, deepcopy(self._average), [memory.copy() for memory in self._memories()]
        )

    def _resume(self, moment: "_Moment") -> None:
        self._state, self._sent, self.tip = moment.state, moment.sent, moment.tip
        self._average = deepcopy(moment.average)
        for memory, before in zip(self._memories(), moment.memories, strict=True):
            memory[:] = before

    def _held(self, command: np.ndarray, measured: Span | None = None) -> np.ndarray:
        """Return the tip (3,) m after the setpoints (hold, n) Pa, or what is ``measured`` behind the valves."""
        step_s = self._route.step_s
        supplied = self._valve.lead(held(command), step_s)
        if measured is not None:
            supplied = Span(*(np.where(np.isfinite(known), known, part) for known, part in zip(measured, supplied, strict=True)))
        acting = of_steps(self._body, self._chamber.lead(supplied, step_s))
        if not self._sensed:
            self._state = self._go(acting)
            return np.asarray(self._body.observe(self._state)[0])
        poses = np.empty((len(acting), 7))
        for pose, row in zip(poses, acting, strict=True):
            self._state = self._go(row[None])
            pose[:3], pose[3:] = self._body.observe(self._state)
        return np.asarray(self._sensor.advance(poses, step_s)[-1, :3])

    def _go(self, acting: np.ndarray):  # type: ignore[no-untyped-def]
        """Return the body's state after the pressures (steps, n) Pa."""
        force = None if self._force is None else np.tile(self._force, (len(acting), 1))
        if isinstance(self._body, FAST):
            return self._body.step(self._state, acting, self._route.step_s, force, *self._hooks)  # type: ignore[arg-type]
        state = self._state
        for k, row in enumerate(acting):
            state = self._body.step(state, row, self._route.step_s, None if force is None else force[k], *self._hooks)
        return state
