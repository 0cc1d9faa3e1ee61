"""Stretches in which the tracking held something else: a marker lost, or taken for another, for longer than an instant."""

import numpy as np

from softrl.diagnosis.checks.gaps import BRIDGED_CHANGE_S
from softrl.recordings.check import resolution

TIMES, LEAST_SHARE = 10.0, 0.02  # a jump is this many times the median step, and this share of the range
DIGITS = 3.0  # and so many of the last digits of a coarse sensor
CALM = 0.5  # of its height: steps in its own direction right before and after a jump are smaller
CLOCKED, CLOCK = 4, 4  # so many jumps in a row, none of which comes sooner after another than by so many samples
RETURNED = 0.5  # of both jumps: how far from where it left the motion may come back
LONGEST_S = 2.0  # a longer stretch may be real
BEFORE_S, BROUGHT = 0.2, 0.5  # what a pressure does so long before a jump, and in shares of the jump: it brings the jump about


def strayed(time: np.ndarray, values: np.ndarray, pressures: np.ndarray) -> np.ndarray:
    """Return which rows (steps,) of ``values`` (steps, n) lie between a jump away and a jump back.

    Parameters
    ----------
    time : (steps,) s
    pressures : (steps, m) commands and measurements, which explain a jump of the body itself

    Notes
    -----
    The motion is cut at its jumps. Of all chains of pieces the one is kept that goes on where it left at the least cost:
    a sample that is passed over costs its time, a jump that is made ``LONGEST_S / 2``. So what jumps once and for all stays, and
    where the tracking goes to and fro between two things that is kept which goes on before and after.
    """
    cuts = _jumps(time, values, _moved(time, pressures))
    wrong = np.zeros(len(values), dtype=bool)
    if len(cuts) < 2:
        return wrong
    first, end = np.r_[0, cuts], np.r_[cuts, len(values)]
    span = _span(pressures)
    cost, before = np.full(len(first), np.inf), np.zeros(len(first), dtype=int)
    cost[0] = 0.0
    for j in range(1, len(first)):
        cost[j], before[j] = cost[j - 1] + LONGEST_S / 2.0, j - 1
        for i in range(j - 2, -1, -1):
            apart = time[first[j]] - time[end[i] - 1]
            if apart > LONGEST_S:
                break
            if cost[i] + apart < cost[j] and _goes_on(values, end[i], first[j]):
                meanwhile = float((np.ptp(pressures[end[i] - 1 : first[j] + 1], axis=0) / span).max())
                if meanwhile * apart <= BRIDGED_CHANGE_S:  # what was commanded goes with the rows
                    cost[j], before[j] = cost[i] + apart, i
    j = len(first) - 1
    while j > 0:
        wrong[end[before[j]] : first[j]] = True
        j = before[j]
    return wrong


def _goes_on(values: np.ndarray, left: int, back: int) -> bool:
    """Return whether the motion, gone by a jump at row ``left``, comes by one at row ``back`` to where it was."""
    jumps = min(np.linalg.norm(values[row] - values[row - 1]) for row in (left, back))
    return bool(np.linalg.norm(values[back] - values[left - 1]) < RETURNED * jumps)


def _moved(time: np.ndarray, pressures: np.ndarray) -> np.ndarray:
    """Return how far (steps - 1,) the pressures moved before every step of the motion, the most of all in shares of its range."""
    since = np.minimum(np.searchsorted(time, time[1:] - BEFORE_S), np.maximum(np.arange(len(time) - 1) - 1, 0))
    return np.asarray((np.abs(pressures[1:] - pressures[since]) / _span(pressures)).max(axis=1))


def _span(pressures: np.ndarray) -> np.ndarray:
    return np.asarray(np.maximum(np.ptp(pressures, axis=0), 1e-300))


def _jumps(time: np.ndarray, values: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return the rows before which ``values`` jump, though no pressure ``moved`` (steps - 1,) much.

    Where a step beside it goes on in its direction the body moves swiftly, and where all come by a slow clock a slow sensor
    follows it.
    """
    step = np.diff(values, axis=0)
    size, span = np.linalg.norm(step, axis=1), float(np.linalg.norm(np.ptp(values, axis=0)))
    along = np.r_[0.0, np.sum(step[1:] * step[:-1], axis=1), 0.0]  # of every step with the next
    calm = np.maximum(along[:-1], along[1:]) < CALM * size**2
    digit = float(np.linalg.norm(resolution(values)))
    found = np.flatnonzero(calm & (size > max(TIMES * float(np.median(size)), LEAST_SHARE * span, DIGITS * digit)))
    groups = np.split(found, np.flatnonzero(np.diff(time[found]) > LONGEST_S) + 1)
    kept = [group for group in groups if len(group) < CLOCKED or np.diff(group).min() < CLOCK]
    found = np.concatenate([found[:0], *kept])
    return found[moved[found] * span < BROUGHT * size[found]] + 1
