"""Direct solution of the Newton equations, with a factorisation that tells whether the Hessian is positive."""

import importlib
import importlib.util
import logging
import weakref
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from softrl.core.errors import SolverError

log = logging.getLogger(__name__)


class LinearSolver(Protocol):
    """Factorises symmetric matrices of one pattern, given by their upper triangle."""

    def factorise(self, upper: sp.csr_matrix) -> bool:
        """Keep the factors and return True, or return False where the matrix is not positive definite."""
        ...

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution for ``right`` (n,) or (n, k)."""
        ...


def linear_solver() -> LinearSolver:
    """Return PARDISO where pypardiso is installed, else SciPy's SuperLU (three to five times slower)."""
    return PardisoCholesky() if importlib.util.find_spec("pypardiso") else SuperLuSolver()


class PardisoCholesky:
    """Cholesky factors by MKL PARDISO; the symbolic analysis is done once."""

    NOT_POSITIVE = -4  # PARDISO's error number for a zero or negative pivot
    ANALYSE, FACTORISE, SOLVE = 11, 22, 33
    # all settings are ours, and zero but for these; nested dissection; no refinement of solutions, right to 1e-11 without: with
    # MKL's own settings two rounds of it follow every solve, which takes three to four times as long
    SETTINGS = ((1, 1), (2, 2), (8, 0))

    def __init__(self) -> None:
        pypardiso = importlib.import_module("pypardiso")
        self._failure = importlib.import_module("pypardiso.pardiso_wrapper").PyPardisoError
        self._solver = pypardiso.PyPardisoSolver(mtype=2)
        for number, value in self.SETTINGS:
            self._solver.set_iparm(number, value)
        self._upper: sp.csr_matrix | None = None
        weakref.finalize(self, self._solver.free_memory, everything=True)  # MKL keeps the factors otherwise

    def factorise(self, upper: sp.csr_matrix) -> bool:
        """Factorise; a failed factorisation leaves nothing to solve with."""
        none = np.zeros((upper.shape[0], 1), order="F")
        if self._upper is None:
            self._solver.set_phase(self.ANALYSE)
            self._solver._call_pardiso(upper, none)
        self._upper = upper
        self._solver.set_phase(self.FACTORISE)
        try:
            self._solver._call_pardiso(upper, none)
        except self._failure as failure:
            if failure.value != self.NOT_POSITIVE:
                raise SolverError(
                    f"PARDISO failed with error {failure.value} on {upper.shape[0]} unknowns"
                ) from failure
            return False
        return True

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve with the last factors."""
        self._solver.set_phase(self.SOLVE)
        return self._solver._call_pardiso(self._upper, np.asfortranarray(right, dtype=float))


class SuperLuSolver:
    """LDU factors by SuperLU without row exchanges, so that the signs of the pivots show definiteness."""

    def __init__(self) -> None:
        self._factors: SuperLU | None = None

    def factorise(self, upper: sp.csr_matrix) -> bool:
        """Factorise; False where a pivot is not positive."""
        full = (upper + sp.triu(upper, 1).T).tocsc()
        try:
            self._factors = splu(
                full, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError:  # SuperLU's word for an exactly singular matrix
            return False
        exchanged = not np.array_equal(self._factors.perm_r, self._factors.perm_c)
        return not exchanged and bool((self._factors.U.diagonal() > 0).all())

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solve with the last factors."""
        if self._factors is None:
            raise SolverError("no factors to solve with; factorise first")
        return self._factors.solve(np.ascontiguousarray(right, dtype=float))
