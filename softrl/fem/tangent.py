"""What is known around an equilibrium: how it answers its loads, and equilibria near it by the same factors."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softrl.fem.coupling import Pose
from softrl.fem.solver import LinearSolver


@dataclass(frozen=True)
class Tangent:
    """How an equilibrium answers a change of its load (p_1 .. p_n, F_x, F_y, F_z).

    Attributes
    ----------
    change : (unknowns, n + 3) d unknowns / d load
    compliance : (n + 3, n + 3) d (volumes, tip) / d load, symmetric up to round-off
    stiffness : (n + 3, n + 3) T' K_viscous T with T = d nodes / d load, what stiffness-proportional damping multiplies
    mass : (n + 3, n + 3) T' M T
    shapes : (n + 3, nodes, 3) T' itself
    viscous : (pairs, 3, 3) N/m, blocks of K_viscous
    """

    change: np.ndarray
    compliance: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    shapes: np.ndarray
    viscous: np.ndarray

    @property
    def width(self) -> int:
        """The number of loads, ``n + 3``."""
        return len(self.compliance)


class Nearby(NamedTuple):
    """An equilibrium near the one at which factors were made, which are enough for its answers.

    Attributes
    ----------
    pose : where it is;  part : of the change of load that leads there;  upper : its stiffness, upper triangle
    solver : holds the factors
    """

    pose: Pose
    part: float
    upper: sp.csr_matrix
    solver: LinearSolver

    def answer(self, before: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the answer (unknowns, k) to ``forces``, which was ``before`` at the factors: one correction of it.

        It leaves an error of second order in the distance.
        """
        resisted = self.upper @ before + self.upper.T @ before - self.upper.diagonal()[:, None] * before
        return before + self.solver.solve(forces - resisted)
