"""Factors made elsewhere, corrected by what the steps since then have taught."""

import numpy as np

from softrl.fem.solver import LinearSolver

LEAST_COSINE = 1e-8  # between a step and the change of forces, below which nothing is learnt of it


class Secants:
    """The inverse of a Hessian near which ``solver`` holds factors, by limited-memory BFGS.

    Nocedal, J. and Wright, S. J., Numerical Optimization (2006), section 7.2: two loops, between them those factors.
    A slender body has soft modes that stale factors alone get wrong for many steps.
    """

    def __init__(self, solver: LinearSolver) -> None:
        self._solver = solver
        self._pairs: list[tuple[np.ndarray, np.ndarray, float]] = []

    def learn(self, step: np.ndarray, change: np.ndarray) -> None:
        """Learn that ``step`` (unknowns,) changed the residual by ``change`` (unknowns,)."""
        curvature = float(step @ change)
        if curvature > LEAST_COSINE * float(np.linalg.norm(step) * np.linalg.norm(change)):
            self._pairs.append((step, change, curvature))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution for ``right`` (unknowns,), by the two loops of limited-memory BFGS."""
        left, shares = right.copy(), []
        for step, change, curvature in reversed(self._pairs):
            shares.append(float(step @ left) / curvature)
            left -= shares[-1] * change
        solution = self._solver.solve(left)
        for (step, change, curvature), share in zip(self._pairs, reversed(shares), strict=True):
            solution += (share - float(change @ solution) / curvature) * step
        return solution
