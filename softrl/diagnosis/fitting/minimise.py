"""Bounded nonlinear least squares for expensive simulations: few evaluations, failures allowed."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError

REUSE = 0.2  # a step that lowers the cost by more than this share updates the Jacobian instead of computing it anew
NEAR = 0.05  # scaled distance within which a Jacobian that is updated is as good as one by differences
SLOW = 0.1  # relative decrease of the cost, by a good Jacobian, after which no large one follows
SAME = 1.05  # times the cost of a fit that ended nearby: a search that comes there would end there too
MOVES = 4  # steps of a fit that is moved on without some of its rows
SETTLED = 0.01  # relative decrease of the cost that ends it
Residual = Callable[[np.ndarray], np.ndarray]
Several = Callable[[list[np.ndarray]], list[np.ndarray | None]]


class Fit(NamedTuple):
    """Outcome of a search: point (p,), residual (rows,), Jacobian (rows, p), half squared sum, evaluations used.

    ``settled`` says that it did not end for want of iterations; ``damping`` is that of the step which would come next.
    """

    point: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    cost: float
    evaluations: int
    settled: bool = True
    damping: float = 1e-3


def jacobian_at(
    residual: Residual,
    point: np.ndarray,
    value: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    step: float,
    several: Several | None = None,
) -> np.ndarray:
    """Return forward differences (rows, p) with ``step``, backward at an upper bound; a failed column is zero.

    ``several`` evaluates many points together, None for those that fail; without it ``residual`` takes one at a time.
    """
    columns = np.zeros((len(value), len(point)))
    moved = {}
    for k in range(len(point)):
        signed = step if point[k] + step <= high[k] else -step
        other = point.copy()
        other[k] = np.clip(point[k] + signed, low[k], high[k])
        if other[k] != point[k]:
            moved[k] = other
    found = several(list(moved.values())) if several else [_or_none(residual, other) for other in moved.values()]
    for (k, other), there in zip(moved.items(), found, strict=True):
        if there is not None:
            columns[:, k] = (there - value) / (other[k] - point[k])
    return columns


def _or_none(residual: Residual, point: np.ndarray) -> np.ndarray | None:
    try:
        return residual(point)
    except SolverError:
        return None


def least_squares(
    residual: Residual,
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    iterations: int,
    step: float = 0.02,
    tolerance: float = 1e-4,
    beaten: float = np.inf,
    before: Fit | None = None,
    several: Several | None = None,
) -> Fit:
    """Return a minimiser of the squared ``residual`` within bounds, by projected Levenberg-Marquardt.

    Parameters
    ----------
    residual : may raise ``SolverError``, which counts as a rejected step
    start, low, high : (p,) in scaled units, in which a change of 1 is plain to see
    iterations : Jacobians at most
    step : of the finite differences, scaled units
    tolerance : relative decrease of the cost that ends the search
    beaten : cost above which the search ends as soon as it goes on slowly
    before : a fit from another start; the search ends where it comes to the same place
    several : as for ``jacobian_at``
    """
    point = np.clip(start, low, high)
    value = residual(point)
    cost, used, damping = 0.5 * float(value @ value), 1, 1e-3
    if before is not None and comes_to(before, point, cost):
        return before
    settled = False
    jacobian, exact, at = jacobian_at(residual, point, value, low, high, step, several), True, point
    used += len(point)
    for _ in range(iterations):
        found = _try_steps(residual, point, value, jacobian, cost, low, high, damping)
        used += found.tries
        settled = found.point is None and exact
        if settled:
            break
        decrease = (cost - found.cost) / max(cost, 1e-300)
        if found.point is not None:
            jacobian = _updated(jacobian, found.point - point, found.value - value)
            point, value, cost, damping = found.point, found.value, found.cost, found.damping
        settled = (exact and (decrease < tolerance or (cost > beaten and decrease < SLOW))) or comes_to(before, point, cost)
        if settled:
            break
        exact = decrease < REUSE
        if exact and (found.point is None or np.abs(point - at).max() > NEAR):
            jacobian, at = jacobian_at(residual, point, value, low, high, step, several), point
            used += len(point)
    if np.abs(point - at).max(initial=0.0) > NEAR:
        jacobian = jacobian_at(residual, point, value, low, high, step, several)
        used += len(point)
    return Fit(point, value, jacobian, cost, used, settled)


def comes_to(before: Fit | None, point: np.ndarray, cost: float) -> bool:
    """Return whether a search at ``point`` (p,) has come to where another ended."""
    return before is not None and cost <= SAME * before.cost and bool(np.abs(point - before.point).max() <= NEAR)


def refine(
    residual: Residual,
    start: np.ndarray,
    known: np.ndarray,
    own: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    steps: int,
    damping: float = 1e-3,
    step: float = 0.05,
) -> Fit:
    """Return a rough minimiser in few evaluations: columns ``own`` by differences at the start, the rest ``known``.

    After every step the Jacobian (rows, p) is updated instead of computed anew.
    """
    point = np.clip(start, low, high)
    value = residual(point)
    cost, jacobian = 0.5 * float(value @ value), known.copy()
    jacobian[:, own] = _own_columns(residual, point, value, own, low, high, step)
    used = 1 + len(own)
    for _ in range(steps):
        found = _try_steps(residual, point, value, jacobian, cost, low, high, damping, 3)
        used, damping = used + found.tries, found.damping
        if found.point is None:
            break
        decrease = (cost - found.cost) / max(cost, 1e-300)
        jacobian = _updated(jacobian, found.point - point, found.value - value)
        point, value, cost = found.point, found.value, found.cost
        if decrease < 0.01:
            break
    return Fit(point, value, jacobian, cost, used, damping=damping)


def moved_on(residual: Residual, fit: Fit, rows: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the whole residual (rows,) after a few steps from ``fit`` that lower it on ``rows`` (rows,) alone.

    The Jacobian is that of the fit, updated after every step.
    """
    whole = fit.residual

    def partly(u: np.ndarray) -> np.ndarray:
        nonlocal tried
        tried = residual(u)
        return tried[rows]

    point, value, jacobian, tried = fit.point, fit.residual[rows], fit.jacobian[rows], whole
    cost, damping = 0.5 * float(value @ value), 1e-3
    for _ in range(MOVES):
        found = _try_steps(partly, point, value, jacobian, cost, low, high, damping)
        if found.point is None:
            break
        whole, decrease = tried, (cost - found.cost) / max(cost, 1e-300)
        jacobian = _updated(jacobian, found.point - point, found.value - value)
        point, value, cost, damping = found.point, found.value, found.cost, found.damping
        if decrease < SETTLED:
            break
    return whole


def _own_columns(
    residual: Residual,
    point: np.ndarray,
    value: np.ndarray,
    own: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    step: float,
) -> np.ndarray:
    def partly(u: np.ndarray) -> np.ndarray:
        whole = point.copy()
        whole[own] = u
        return residual(whole)

    return jacobian_at(partly, point[own], value, low[own], high[own], step)


def _updated(jacobian: np.ndarray, moved: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return the Jacobian after Broyden's rank-one update, which makes it explain the last step."""
    return np.asarray(jacobian + np.outer(change - jacobian @ moved, moved) / max(float(moved @ moved), 1e-300))


class _Step(NamedTuple):
    point: np.ndarray | None
    value: np.ndarray
    cost: float
    damping: float
    tries: int


def _try_steps(
    residual: Residual,
    point: np.ndarray,
    value: np.ndarray,
    jacobian: np.ndarray,
    cost: float,
    low: np.ndarray,
    high: np.ndarray,
    damping: float,
    limit: int = 6,
) -> _Step:
    """Return the first damped step that lowers the cost, with more damping after every refusal."""
    gradient = jacobian.T @ value
    stuck = ((point <= low) & (gradient > 0.0)) | ((point >= high) & (gradient < 0.0))
    free = np.flatnonzero(~stuck)
    if not len(free) or not np.isfinite(gradient).all():
        return _Step(None, value, cost, damping, 0)
    normal = jacobian[:, free].T @ jacobian[:, free]
    scale = np.diag(normal) + 1e-6 * np.trace(normal) / len(free)
    for tries in range(1, limit + 1):
        moved = point.copy()
        moved[free] -= np.linalg.lstsq(normal + damping * np.diag(scale), gradient[free], rcond=None)[0]
        moved = np.clip(moved, low, high)
        try:
            trial = residual(moved)
            trial_cost = 0.5 * float(trial @ trial)
        except SolverError:
            trial_cost = np.inf
        if trial_cost < cost:
            return _Step(moved, trial, trial_cost, max(damping / 5.0, 1e-6), tries)
        damping *= 8.0
    return _Step(None, value, cost, damping, limit)
