"""What an effect seems to save where it acts in some pieces of the recordings alone, as far as straight lines tell."""

from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import Choice, neutral, starts
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import join
from softrl.diagnosis.search.look import Base

GENTLE = 0.2  # of an effect's typical size, for differences


class Pieces(NamedTuple):
    """Least squares by an effect's parameters, piece by piece: what it changes in one it does not change in another.

    Attributes
    ----------
    normal : (pieces, p, p) of what the parameters change
    free : (pieces, q, p) of that, what free parameters can do as well
    slope : (pieces, p) by what is left
    """

    normal: np.ndarray
    free: np.ndarray
    slope: np.ndarray

    def saved(self, acts: np.ndarray) -> float:
        """Return what of the squared error goes where the effect acts in some pieces (pieces,) bool alone."""
        normal, free, slope = (side[acts].sum(axis=0) for side in self)
        return float(slope @ np.linalg.lstsq(normal - free.T @ free, slope, rcond=1e-9)[0])


def pieces_of(fitting: Problem, base: Base, choice: Choice, piece: np.ndarray) -> Pieces:
    """Return the least squares of ``choice``, which acts everywhere, by the ``piece`` (bins,) to which each bin belongs."""
    columns = _columns(fitting, base, choice)
    row = np.repeat(piece, len(base.left) // len(piece))
    sides = [(columns[row == k], base.basis[row == k], base.left[row == k]) for k in range(int(piece.max()) + 1)]
    return Pieces(
        np.stack([c.T @ c for c, _, _ in sides]), np.stack([q.T @ c for c, q, _ in sides]),
        np.stack([c.T @ left for c, _, left in sides]),
    )  # fmt: skip


def _columns(fitting: Problem, base: Base, choice: Choice) -> np.ndarray:
    """Return what each parameter changes (rows, p); nothing where the effect does not run."""
    hypothesis, zero, typical = base.trial.hypothesis.with_effect(choice), neutral(choice), starts(choice)[0]
    columns = np.zeros((len(base.left), len(zero)))
    for k in range(len(zero)):
        point = zero.copy()
        point[k] += GENTLE * (typical[k] - zero[k] or 1.0)
        try:
            columns[:, k] = fitting.residual(hypothesis, join(base.trial, point)).flat - base.trial.fit.residual
        except SolverError:
            continue
    return columns
