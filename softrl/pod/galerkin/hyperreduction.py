"""ECSW: few elements, weighted, whose forces do the work of all on a reduced basis."""

from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError

BATCH = 8  # elements that are taken up at a time


class Sampling(NamedTuple):
    """Elements (k,), their weights (k,) > 0, and the relative error that is left on the training work."""

    elements: np.ndarray
    weights: np.ndarray
    error: float


def sample_elements(work: np.ndarray, tolerance: float, most: int) -> Sampling:
    """Return weights >= 0 of few elements with ``work @ weights`` near ``work.sum(axis=1)``.

    Parameters
    ----------
    work : (rows, elements) generalised force of each element in each training state, one row a state and mode
    tolerance : relative to the norm of the sum, at which the search ends
    most : elements at most

    Raises
    ------
    SolverError
        If ``most`` elements are too few.

    Notes
    -----
    Farhat, Chapman, Avery: Structure-preserving, stability, and accuracy properties of the energy-conserving sampling and
    weighting method (2015), no number checked: non-negative least squares that stops early. Several elements at once are
    taken up, which changes the choice, not the condition. Weights that are not negative keep the energy bounded below.
    """
    total = work.sum(axis=1)
    goal = tolerance * float(np.linalg.norm(total))
    active, weights = np.zeros(0, dtype=int), np.zeros(0)
    residual = total
    while (error := float(np.linalg.norm(residual))) > goal:
        gain = work.T @ residual
        gain[active] = -np.inf
        best = np.argsort(-gain)[: min(BATCH, most - len(active))]
        best = best[gain[best] > 0.0]
        if not len(best):
            raise SolverError(
                f"{len(active)} elements leave {error / np.linalg.norm(total):.1e} of the work, more than "
                f"{tolerance:.1e}; allow more elements, a larger tolerance, or fewer modes"
            )
        active, weights = _least_squares(work, total, np.r_[active, best], np.r_[weights, np.zeros(len(best))])
        residual = total - work[:, active] @ weights
    order = np.argsort(active)
    return Sampling(active[order], weights[order], error / float(np.linalg.norm(total)))


def _least_squares(
    work: np.ndarray, total: np.ndarray, active: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the active elements and weights of the least-squares solution, stepping back where one turns negative."""
    while True:
        columns = work[:, active]
        gram = columns.T @ columns
        gram[np.diag_indices_from(gram)] *= 1.0 + 1e-12
        wanted = np.linalg.solve(gram, columns.T @ total)
        if (wanted > 0.0).all():
            return active, wanted
        falling = wanted <= 0.0
        share = np.min(weights[falling] / np.maximum(weights[falling] - wanted[falling], 1e-300))
        weights = weights + share * (wanted - weights)
        keep = ~(falling & (weights <= 1e-12 * max(weights.max(), 1e-300)))
        if keep.all():  # round-off: drop the most negative
            keep[np.argmin(wanted)] = False
        active, weights = active[keep], weights[keep]
