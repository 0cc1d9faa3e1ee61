"""Maxwell branches beside an elastic wall: each one's overstress, and what all of them keep of it until a step's end.

A body asks for the resistance several times a step, after the same two times: its step, and the part of it after which a first
stage ends. What the branches will have kept by then does not depend on the answer, and is worked out once a step, when states are
committed: an exponential for each branch and call is what took longest.
"""

import math

import numpy as np

from softrl.core.compiled import summing
from softrl.effects.effect import STAGE
from softrl.effects.port import ADDED, ADDED_SLOPE, wall

TIMES = 2  # after which the resistance is known beforehand: of a stage, and of the step


def slots(branches: int, chambers: int) -> int:
    """Return the length of the state of ``relax``: all zero at rest.

    In each chamber every branch's overstress, and the last elastic resistance; which share of its overstress a branch keeps over
    the step, and which of a change it adds; and for each of ``TIMES`` the time, the slope, what of the overstress acts then in
    each chamber, and the weight of each branch in that.
    """
    return (branches + 1) * chambers + 2 * branches + TIMES * (2 + chambers + branches)


@summing
def relax(parameters: np.ndarray, branches: int, state: np.ndarray, port: np.ndarray, dt: float, commit: bool) -> None:
    """Add every branch's overstress after ``dt``, exact for a resistance that changes linearly until then.

    ``parameters`` are share and relaxation time of each branch in turn, and then the chamber.
    """
    n, chamber = port.shape[1], int(parameters[2 * branches])
    last = branches * n
    keeps = last + n
    first, size = keeps + 2 * branches, 2 + n + branches
    second = first + size
    if commit and state[second] != dt:
        _prepare(parameters, branches, state[keeps:first], state[first:second], STAGE * dt)
        _prepare(parameters, branches, state[keeps:first], state[second:], dt)
    at = first if state[first] == dt else second
    for i in range(n):
        if chamber >= 0 and chamber != i:
            continue
        elastic, slope = wall(port, chamber, i)
        change, own = elastic - state[last + i], state[i * branches : (i + 1) * branches]
        if state[at] == dt:
            port[ADDED, i] += state[at + 2 + i] + state[at + 1] * change
            port[ADDED_SLOPE, i] += state[at + 1] * slope
        else:
            for m in range(branches):
                share, tau = parameters[2 * m], parameters[2 * m + 1]
                faded = math.expm1(-dt / tau)
                port[ADDED, i] += share * ((1.0 + faded) * own[m] - tau / dt * faded * change)
                port[ADDED_SLOPE, i] -= share * tau / dt * faded * slope
        if commit:
            state[last + i] = elastic
            then = after = 0.0
            for m in range(branches):
                own[m] = state[keeps + m] * own[m] + state[keeps + branches + m] * change
                then += state[first + 2 + n + m] * own[m]
                after += state[second + 2 + n + m] * own[m]
            state[first + 2 + i], state[second + 2 + i] = then, after


@summing
def _prepare(parameters: np.ndarray, branches: int, step: np.ndarray, known: np.ndarray, dt: float) -> None:
    """Fill what is ``known`` of the time ``dt``, s, but for what acts in the chambers; ``step`` is left as that of the last."""
    known[0], known[1] = dt, 0.0
    for m in range(branches):
        share, tau = parameters[2 * m], parameters[2 * m + 1]
        faded = math.expm1(-dt / tau)
        step[m], step[branches + m] = 1.0 + faded, -tau / dt * faded
        known[1] += share * step[branches + m]
        known[len(known) - branches + m] = share * step[m]
