"""What a time step resists: the change of strain from its start to its end, compiled.

The full model resists that change, not its rate at some moment: half its square is that of a step in the viscosity, see
``pod.step.chord``.
"""

from typing import Any

import numpy as np

from softrl.core.compiled import borrowing
from softrl.pod.step.chord import fill_chord
from softrl.pod.step.inside import fill_drag
from softrl.pod.step.potential import square_of

TINY = 1e-300


@borrowing
def fill_viscosity(start: np.ndarray, by: np.ndarray, tables: Any, work: Any, held: Any) -> None:
    """Fill viscosity and the inside's half way of a step from ``start`` by ``by`` (r,), and the force of its slope.

    The force is never more than would turn what damps into what drives. ``work`` and ``held`` are those of ``pod.step.kernel``.
    """
    values, middle, root = work.values, work.middle, work.root
    _, stiff, steep, inside, _ = held
    for i in range(len(by)):
        middle[i] = start[i] + 0.5 * by[i]
    metric = tables.stiffness_root, tables.stiffness_factor
    fill_chord(metric, middle, by, tables.drag_root.shape[1], tables, work, stiff, steep)
    fill_drag(root, tables, values, inside)
    driven = 0.0
    for i in range(len(by)):
        driven -= steep[i] * by[i]
    share = driven / max(square_of(stiff, by), TINY)
    if share > 1.0:
        for i in range(len(by)):
            steep[i] /= share
