"""What the last two steps of many trajectories tell of the next one, as ``pod.step.past``: the last axis is the lane."""

import numba as nb
import numpy as np

from softrl.core.compiled import standing
from softrl.pod.lanes.algebra import Lanes, put
from softrl.pod.step.past import Past


@nb.njit(cache=True)
def make_pasts(r: int, lanes: int) -> Past:
    """Return room for ``r`` coordinates of ``lanes`` lanes; Hessians are (pairs, lanes)."""
    one, pairs = (r, lanes), (r * (r + 1) // 2, lanes)
    return Past(np.zeros(one), np.zeros(one), np.zeros(pairs), np.zeros(pairs))


@standing
def keep(y: np.ndarray, lanes: int, past: Past, held: Lanes) -> None:
    """Keep the potential's derivatives at the first ``lanes`` of ``y`` (r, >= lanes), each at its place in ``order``."""
    for lane in range(lanes):
        place = held.order[lane]
        for i in range(len(y)):
            past.seen[i, place], past.slope[i, place] = y[i, lane], held.gradient[i, lane]
        for pair in range(len(held.pairs)):
            past.curve[pair, place] = held.pairs[pair, lane]


@standing
def keep_curves(past: Past) -> None:
    """Keep the Hessians as those of a step earlier."""
    for pair in range(len(past.curve)):
        put(past.curve_before[pair], past.curve[pair])


@standing
def foretell_potentials(y: np.ndarray, past: Past, held: Lanes) -> None:
    """Fill ``gradient`` and ``pairs``, the Hessian, that are likely at ``y`` (r, lanes), a step from where it was asked last.

    Asked once a step: the last curves are then those of a step earlier.
    """
    pair = 0
    for i in range(len(y)):
        put(held.gradient[i], past.slope[i])
    for i in range(len(y)):
        for j in range(i, len(y)):
            for lane in range(y.shape[1]):
                now = past.curve[pair, lane]
                change = now - past.curve_before[pair, lane]
                mean = now + 0.5 * change
                past.curve_before[pair, lane] = now
                held.pairs[pair, lane] = now + change
                held.gradient[i, lane] += mean * (y[j, lane] - past.seen[j, lane])
                if i != j:
                    held.gradient[j, lane] += mean * (y[i, lane] - past.seen[i, lane])
            pair += 1
