"""How the compliance of an equilibrium changes with its load: third derivatives of its energy, without a solve.

The first derivatives of the nodes by the load are enough for the third of the energy (the 2n + 1 rule of perturbation).
"""

from itertools import permutations

import numpy as np

from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel, Tangent

STEP_M = 1e-7  # largest shift of a node: far above round-off, far below the motion


def compliance_slope(model: FemModel, pose: Pose, load: np.ndarray, tangent: Tangent) -> np.ndarray:
    """Return d compliance / d load (n + 3, n + 3, n + 3), symmetric in all three, at an equilibrium.

    ``compliance = g' T`` with g the unit loads and ``H T = g`` changes by ``dg' T + T' dg - T' dH T``, where dg and dH
    are differences along each column of T.
    """
    change = tangent.change
    slopes = []
    for column, unit in zip(change.T, np.eye(len(load)), strict=True):
        part = STEP_M / np.abs(column[: 3 * len(model.coupling.free)]).max()
        there = model.coupling.move(pose, part * column)
        upper = model.stiffness(there, load + part * unit)
        bent = change.T @ (upper @ change)
        stiff = bent + bent.T - change.T @ (upper.diagonal()[:, None] * change)
        push = model.load_directions(there).T @ change
        slopes.append((push + push.T - stiff - tangent.compliance) / part)
    slope = np.array(slopes)
    return np.mean([slope.transpose(order) for order in permutations(range(3))], axis=0)
