"""One implicit step of the lumped body, solved by Newton's method with a Jacobian that is kept and corrected on the way."""

from typing import Any

import numpy as np

from softrl.core.compiled import summing
from softrl.effects.port import slope_of
from softrl.pcc.forces import fill_residual
from softrl.pcc.model import MOVED, NEXT, OTHER, RESIDUAL, SEEN, STEP, TRIAL, stretching

TOLERANCE = 1e-10  # rad or strain: some ten picometres at the tip of most robots
ACCEPTED = 1e-7  # at a kink of friction or contact: 20 nm at the tip of a robot of 0.2 m
CAUTION = 10.0  # times as slowly as the last step shrank, the next may shrink: the inertia changes with the shape
MAX_ITERATIONS = 60
QUICK = 8  # steps with a Jacobian that is corrected on the way, before a careful search begins
NUDGE = 1e-7  # of a coordinate, for the Jacobian by differences
SAME = 0.01  # of the body's own slope: a smaller change of an effect's is left to the corrections
SLOW = 0.2  # a Newton step that shrinks less than to this share asks for a new Jacobian
SHORTEST = 1e-4  # share of a Newton step below which it is taken as it is


@summing
def _invert(matrix: np.ndarray, inverse: np.ndarray) -> None:
    """Fill the ``inverse`` of a ``matrix``, which is used up: Gauss and Jordan's elimination with exchange of rows."""
    order = len(matrix)
    for i in range(order):
        for j in range(order):
            inverse[i, j] = 1.0 if i == j else 0.0
    for k in range(order):
        best = k
        for i in range(k + 1, order):
            if abs(matrix[i, k]) > abs(matrix[best, k]):
                best = i
        for j in range(order):
            matrix[k, j], matrix[best, j] = matrix[best, j], matrix[k, j]
            inverse[k, j], inverse[best, j] = inverse[best, j], inverse[k, j]
        per = 1.0 / matrix[k, k]
        for j in range(order):
            matrix[k, j] *= per
            inverse[k, j] *= per
        for i in range(order):
            factor = matrix[i, k]
            if i != k and factor != 0.0:
                for j in range(order):
                    matrix[i, j] -= factor * matrix[k, j]
                    inverse[i, j] -= factor * inverse[k, j]


@summing
def _newton_step(order: Any, inverse: np.ndarray, residual: np.ndarray, step: np.ndarray) -> float:
    """Fill ``step = -inverse residual`` and return its largest entry."""
    size = 0.0
    for i in range(len(order)):
        step[i] = 0.0
        for j in range(len(order)):
            step[i] -= inverse[i, j] * residual[j]
        size = max(size, abs(step[i]))
    return size


@summing
def _quick(
    work: np.ndarray,
    inverse: np.ndarray,
    dt: float,
    per_s: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    slopes: np.ndarray,
) -> bool:
    """Try to solve one step with a kept ``inverse`` Jacobian that is corrected on the way; return whether it converged.

    What the effects' slopes change is known at once, what else changes is learned by Broyden's corrections. The search stops
    once the steps shrink fast enough for the sum of all further ones to stay below the tolerance.
    ``work[RESIDUAL]`` belongs to ``work[TRIAL]`` before and, without success, after it.
    """
    trial, residual, step, following = work[TRIAL], work[RESIDUAL], work[STEP], work[NEXT]
    order = model.order
    m = len(order)
    _follow(inverse, slopes, ports[0], model, work)
    size = _newton_step(order, inverse, residual, step)
    for _ in range(QUICK):
        for i in range(m):
            trial[i] += step[i]
        if size < 0.01 * TOLERANCE:
            return True
        fill_residual(trial, residual, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains)
        known = _follow(inverse, slopes, ports[0], model, work)
        after = _newton_step(order, inverse, residual, following)
        if not after < 0.5 * size and after >= TOLERANCE:
            return False
        if after < TOLERANCE or CAUTION * after * after < TOLERANCE * (size - after):
            for i in range(m):
                trial[i] += following[i]
            return True
        if known:
            _correct(order, inverse, step, following)
        size = _newton_step(order, inverse, residual, step)
    return False


@summing
def _follow(inverse: np.ndarray, slopes: np.ndarray, port: np.ndarray, model: Any, work: np.ndarray) -> bool:
    """Bring the ``inverse`` Jacobian from the effects' ``slopes`` to those in ``port``; return if it had them.

    Sherman and Morrison's formula, slope by slope: ``slopes`` (chambers, chambers) are of one chamber by another's strain.
    """
    push, to_strain, rest, moved, seen = model.push, model.to_strain, model.slope, work[MOVED], work[SEEN]
    m, moving, known = len(model.order), stretching(model), True
    for c in range(len(slopes)):
        for d in range(len(slopes)):
            slope = slope_of(port, c, d)
            change = slope - slopes[c, d]
            if abs(change) < SAME * rest[c]:
                continue
            known, slopes[c, d], along = False, slope, 0.0
            for i in range(m):
                moved[i], seen[i] = 0.0, 0.0
                for j in range(moving):
                    moved[i] += inverse[i, j] * push[j, c]
                    seen[i] += to_strain[d, j] * inverse[j, i]
            for i in range(moving):
                along += to_strain[d, i] * moved[i]
            share = change / (1.0 + change * along)
            for i in range(m):
                for j in range(m):
                    inverse[i, j] -= share * moved[i] * seen[j]
    return known


@summing
def _correct(order: Any, inverse: np.ndarray, step: np.ndarray, following: np.ndarray) -> None:
    """Correct the ``inverse`` Jacobian such that it maps the change of the residual over ``step`` to ``step``.

    Broyden's first update in the form of Sherman and Morrison; ``following`` is what the old inverse proposes next.
    """
    m = len(order)
    scale = 0.0
    for i in range(m):
        scale += step[i] * (step[i] - following[i])
    if scale <= 0.0:
        return
    for j in range(m):
        along = 0.0
        for i in range(m):
            along += step[i] * inverse[i, j]
        for i in range(m):
            inverse[i, j] += following[i] * along / scale


@summing
def solve_step(
    work: np.ndarray,
    jacobian: np.ndarray,
    inverse: np.ndarray,
    dt: float,
    per_s: float,
    pressure: np.ndarray,
    tip_force: np.ndarray,
    model: Any,
    hooks: Any,
    ports: Any,
    strains: np.ndarray,
    slopes: np.ndarray,
) -> bool:
    """Solve one implicit step for ``work[TRIAL]``; return whether it converged.

    Where corrections of the kept Jacobian do not do, Newton with one by differences: a fresh one that overshoots
    (friction and contact have kinks) is followed over a shorter way, until the next step is smaller.
    """
    trial, residual, step, other = work[TRIAL], work[RESIDUAL], work[STEP], work[OTHER]
    order = model.order
    m = len(order)
    fill_residual(trial, residual, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains)
    if inverse[0, 0] != 0.0 and _quick(
        work, inverse, dt, per_s, pressure, tip_force, model, hooks, ports, strains, slopes
    ):
        return True
    stale, size = True, np.inf
    for _ in range(MAX_ITERATIONS):
        fresh = stale
        if stale:
            for j in range(m):
                kept = trial[j]
                trial[j] = kept + NUDGE
                fill_residual(trial, other, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains)
                trial[j] = kept
                for i in range(m):
                    jacobian[i, j] = (other[i] - residual[i]) / NUDGE
            _invert(jacobian, inverse)
            for c in range(len(slopes)):
                for d in range(len(slopes)):
                    slopes[c, d] = slope_of(ports[0], c, d)
            stale = False
        size = _newton_step(order, inverse, residual, step)
        for i in range(m):
            trial[i] += step[i]
        if size < TOLERANCE:
            return True
        share = 1.0
        while True:
            fill_residual(trial, other, work, dt, per_s, pressure, tip_force, model, hooks, ports, strains)
            after = _newton_step(order, inverse, other, work[NEXT])
            if after < (1.0 - 0.25 * share) * size or after < TOLERANCE or share < SHORTEST:
                break
            shorter = 0.5 * share if fresh else 0.0
            for i in range(m):
                trial[i] += (shorter - share) * step[i]
            share = shorter
            if not fresh:
                break
        if after < TOLERANCE and share > 0.0:
            for i in range(m):
                trial[i] += work[NEXT, i]
            return True
        stale = share == 0.0 or after > SLOW * size
        if share > 0.0:
            for i in range(m):
                residual[i] = other[i]
        if 0.0 < share < SHORTEST and size < ACCEPTED:
            return True  # at the very kink, where no slope leads on
    return size < ACCEPTED
