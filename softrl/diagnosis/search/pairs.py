"""Two effects at once beside a trial, as far as straight lines tell, where neither explains much without the other."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.effort import parallel
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, neutral, starts
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, join
from softrl.diagnosis.search.look import Base, bases_of

RIDGE = 1e-9  # on unit columns: some say the same, some say nothing


class Moves(NamedTuple):
    """What each parameter of an effect changes beyond what free parameters can do, (rows, p), and by how much it was moved."""

    choice: Choice
    columns: np.ndarray
    by: np.ndarray


class Pair(NamedTuple):
    """Two effects, the hypothesis with both, where a fit may begin, and the squared error that seems to stay."""

    choices: tuple[Choice, Choice]
    hypothesis: Hypothesis
    point: np.ndarray
    cost: float


def best_pairs(fitting: Problem, current: Trial, choices: Sequence[Choice], search: Search) -> list[Pair]:
    """Return the pairs of ``choices`` that seem to explain most beside ``current``, the best first, ``search.keep`` at most."""
    found: dict[tuple[Choice, Choice], Pair] = {}
    for base in bases_of(fitting, current):
        jobs = [(fitting, base, choice) for choice in choices]
        moves = [move for several in parallel(_moves, jobs, search.workers) for move in several]
        for pair in _pairs(base, moves):
            other = found.get(pair.choices)
            if other is None or pair.cost < other.cost:
                found[pair.choices] = pair
    return sorted(found.values(), key=lambda pair: pair.cost)[: search.keep]


def _moves(fitting: Problem, base: Base, choice: Choice) -> list[Moves]:
    """Return what an effect changes, moved up and down where its one parameter may go both ways: what yields may stop."""
    zero, typical = neutral(choice), starts(choice)[0]
    both = len(zero) == 1 and fitting.space(Hypothesis((choice,), ())).bounds[0][0] < zero[0]
    ways = (typical, 2.0 * zero - typical) if both else (typical,)
    return [move for way in ways if (move := _moved(fitting, base, choice, zero, way)) is not None]


def _moved(fitting: Problem, base: Base, choice: Choice, zero: np.ndarray, typical: np.ndarray) -> Moves | None:
    hypothesis, columns, by = base.trial.hypothesis.with_effect(choice), [], typical - zero
    by[by == 0.0] = 1.0
    for k in range(len(zero)):
        point = zero.copy()
        point[k] += by[k]
        try:
            moved = fitting.residual(hypothesis, join(base.trial, point)).flat - base.trial.fit.residual
        except SolverError:
            return None
        columns.append(moved - base.basis @ (base.basis.T @ moved))
    return Moves(choice, np.stack(columns, axis=1), by)


def _pairs(base: Base, moves: Sequence[Moves]) -> list[Pair]:
    """Return every pair of different effects, with what is left by the best linear combination of all their parameters."""
    if not moves:
        return []
    columns = np.hstack([move.columns for move in moves])
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    columns = columns / size
    gram, along, whole = columns.T @ columns, columns.T @ base.left, float(base.left @ base.left)
    ends = np.cumsum([move.columns.shape[1] for move in moves])
    own = [np.arange(end - move.columns.shape[1], end) for end, move in zip(ends, moves, strict=True)]
    found = []
    for first, second in combinations(range(len(moves)), 2):
        one, other = moves[first].choice, moves[second].choice
        if one.name == other.name:
            continue
        mine = np.concatenate([own[first], own[second]])
        block = gram[np.ix_(mine, mine)]
        unit = -np.linalg.solve(block + RIDGE * np.eye(len(mine)), along[mine])
        cost = whole + float(unit @ (2.0 * along[mine] + block @ unit))
        steps = unit / size[mine] * np.concatenate([moves[first].by, moves[second].by])
        point = join(base.trial, np.concatenate([neutral(one), neutral(other)]) + steps)
        hypothesis = base.trial.hypothesis.with_effect(one).with_effect(other)
        found.append(Pair((one, other), hypothesis, point, cost))
    return found
