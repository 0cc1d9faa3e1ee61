"""Where in time and pressure an effect acts: above a pressure only, or only from a time of each run on.

Any effect can be gated. Its kernel runs as ever, and a share of what it changes counts: none below the pressure or before
the time, all a little beyond, in between in proportion. What fills a store is gated where it flows in: air that has left
a chamber is still missing when the leak has closed. A valve on its way is gated by where it is as well as by what it is told:
it vents as slowly as it fills until it is down at the pressure.
"""

import math
from typing import Any

import numba as nb
import numpy as np

from softrl.core.simulator import Hook
from softrl.effects.call import address_of, call_port, call_signal
from softrl.effects.effect import EVERYWHERE, PORT_KERNEL, SIGNAL_KERNEL, Effect
from softrl.effects.port import ADDED, COUPLED, GRAVITY, PRESSURE
from softrl.effects.quaternion import product
from softrl.robots.robot import Robot

GATES = {"above_share": "above a pressure", "since_s": "from a time on"}  # the fields of an effect, in words
WIDTHS = {"since_s": "over_s"}  # the field that says how sudden a gate opens, where that is one
BAND = 0.05  # of the largest pressure: from nothing to all
LONG_S = 1e3  # a step as long as this finds an equilibrium, for which no time passes
GATE = 5  # numbers behind an effect's own parameters: pressure and band Pa, time and how long it takes s, address of the kernel


@nb.njit(cache=True)
def _after(clock: float, dt: float) -> float:
    return clock + dt if dt < LONG_S else clock


@nb.njit(cache=True)
def _late(clock: float, dt: float, parameters: np.ndarray) -> float:
    since = parameters[2 - GATE]
    return min(max((_after(clock, dt) - since) / parameters[3 - GATE], 0.0), 1.0) if since > 0.0 else 1.0


@nb.njit(cache=True)
def _above(pressure: float, parameters: np.ndarray) -> float:
    return min(max((pressure - parameters[-GATE]) / parameters[1 - GATE], 0.0), 1.0)


@nb.njit(cache=True)
def _address(parameters: np.ndarray) -> int:
    return parameters[-1:].view(np.int64)[0]


@nb.njit(cache=True)
def _run(parameters: np.ndarray, state: np.ndarray, own: int, value: np.ndarray, dt: float) -> float:
    """Run the effect, whose are the first ``own`` numbers of the state, on ``value``; return what share acts by now."""
    call_signal(_address(parameters), parameters[:-GATE], state[:own], value, dt)
    late = _late(state[-1], dt, parameters)
    state[-1] = _after(state[-1], dt)
    return late


@nb.njit(SIGNAL_KERNEL, cache=True)
def gated_signal(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let a share of the effect's change of ``value`` count, by the pressure before it."""
    before = value.copy()
    late = _run(parameters, state, len(state) - 1, value, dt)
    for i in range(len(value)):
        value[i] = before[i] + late * _above(before[i], parameters) * (value[i] - before[i])


@nb.njit(cache=True)
def _turned(w: float, x: float, y: float, z: float, point: np.ndarray) -> np.ndarray:
    """Return ``point`` (3,) turned by a unit quaternion."""
    a, b, c = point
    d, e, f = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return np.array([a + w * d + y * f - z * e, b + w * e + z * d - x * f, c + w * f + x * e - y * d])


@nb.njit(SIGNAL_KERNEL, cache=True)
def gated_pose(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let a share of the effect's turn of a pose count, about the same axis, and of its shift beside that."""
    before = value.copy()
    late = _run(parameters, state, len(state) - 1, value, dt)
    if late >= 1.0:
        return
    w, x, y, z = product(value[3], value[4], value[5], value[6], before[3:] * np.array([1.0, -1.0, -1.0, -1.0]))
    sine = math.sqrt(x * x + y * y + z * z)
    size = math.sqrt(w * w + sine * sine)
    shift = value[:3] - _turned(w / size, x / size, y / size, z / size, before[:3])
    half = late * math.atan2(sine, w)
    along = math.sin(half) / sine if sine > 1e-12 else 0.0
    w, x, y, z = math.cos(half) if along > 0.0 else 1.0, along * x, along * y, along * z
    value[:3] = _turned(w, x, y, z, before[:3]) + late * shift
    value[3], value[4], value[5], value[6] = product(w, x, y, z, before[3:])


@nb.njit(SIGNAL_KERNEL, cache=True)
def gated_way(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let a share of a valve's way to ``value`` count, by the pressure that it is told; the shares stand before the clock.

    A gate that this opened closes as the valve gets down: else all that it still has to vent would be gone in the moment in
    which it is told to.
    """
    before = value.copy()
    shares = state[len(state) - 1 - len(value) : len(state) - 1]
    late = _run(parameters, state, len(state) - 1 - len(value), value, dt)
    for i in range(len(value)):
        shares[i] = max(_above(before[i], parameters), min(shares[i], _above(value[i], parameters)))
        value[i] = before[i] + late * shares[i] * (value[i] - before[i])


@nb.njit(SIGNAL_KERNEL, cache=True)
def gated_flow(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let a share of the flow, the effect's first parameter, run into each chamber's store, by the pressure before it."""
    own = parameters[:-GATE].copy()
    flow, chamber = own[0], int(own[-1])
    late = _late(state[-1], dt, parameters)
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            own[0], own[-1] = flow * late * _above(value[i], parameters), i
            call_signal(_address(parameters), own, state[:-1], value, dt)
    state[-1] = _after(state[-1], dt)


@nb.njit(PORT_KERNEL, cache=True)
def gated_body(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Let a share of the resistance that the effect adds count, by the pressure in each chamber."""
    before = port.copy()
    call_port(_address(parameters), parameters[:-GATE], state[:-1], port, dt, commit)
    late = _late(state[-1], dt, parameters)
    for i in range(port.shape[1]):
        share = late * _above(port[PRESSURE, i], parameters)
        for row in range(ADDED, COUPLED):
            port[row, i] = before[row, i] + share * (port[row, i] - before[row, i])
        for j in range(port.shape[1]):
            port[COUPLED + i, j] = before[COUPLED + i, j] + share * (port[COUPLED + i, j] - before[COUPLED + i, j])
    if commit:
        state[-1] = _after(state[-1], dt)


@nb.njit(PORT_KERNEL, cache=True)
def gated_load(parameters: np.ndarray, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Let a share of the force that the effect adds, and of its change of gravity, count."""
    before = port.copy()
    call_port(_address(parameters), parameters[:-GATE], state[:-1], port, dt, commit)
    late = _late(state[-1], dt, parameters)
    for row in range(GRAVITY, port.shape[0]):
        for k in range(port.shape[1]):
            port[row, k] = before[row, k] + late * (port[row, k] - before[row, k])
    if commit:
        state[-1] = _after(state[-1], dt)


def share_at(effect: Effect, since_s: np.ndarray) -> np.ndarray:
    """Return the share of ``effect`` that acts at times (steps,) since a run's first sample, by its gate in time."""
    if effect.since_s <= 0.0:
        return np.ones(len(since_s))
    return np.clip((effect.begun_s + since_s - effect.since_s) / effect.over_s, 0.0, 1.0)


KERNELS = {"body": gated_body, "load": gated_load}


def _gate_of(effect: Effect) -> Any:
    """Return the kernel that gates ``effect``."""
    if effect.stores:
        return gated_flow
    if effect.site == "sensor" and effect.channel == "pose":
        return gated_pose
    on_its_way = effect.site == "valve" and (effect.piped or effect.shifts_time or effect.sticks)
    return gated_way if on_its_way else KERNELS.get(effect.site, gated_signal)


def hook_of(effect: Effect, robot: Robot, before_s: float = 0.0, temperature: np.ndarray | None = None) -> Hook:
    """Return ``effect`` as a kernel takes it, its clock as it stands ``before_s`` before the first sample.

    What goes on with the recording, as temperatures and readings do, begins with each part of a run anew.
    ``temperature`` (seconds,) degree Celsius, one value a second from the first sample on, goes to what needs it.
    """
    kernel, parameters, state = type(effect).kernel, effect.pack(robot), effect.reset(robot)
    if effect.needs == "temperature" and temperature is not None:
        parameters = np.r_[parameters, temperature]
    if effect.clock is not None:
        state[effect.clock] = (effect.begun_s if effect.lasts else 0.0) - before_s
    if not effect.gated:
        return Hook(kernel, parameters, state)
    above = effect.above_share * robot.largest_pa if effect.above_share > EVERYWHERE else -np.inf
    behind = np.array([above, BAND * robot.largest_pa, effect.since_s, effect.over_s, 0.0])
    behind[-1:].view(np.int64)[0] = address_of(kernel)
    gate = _gate_of(effect)
    shares = np.zeros(robot.chambers if gate is gated_way else 0)
    return Hook(gate, np.r_[parameters, behind], np.r_[state, shares, effect.begun_s - before_s])
