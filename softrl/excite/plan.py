"""Choose the blocks that tell rivals apart best within a time budget: a pure function of rivals and blocks.

The score of a program is ``sum over pairs of log(1 + D^2)`` with D the separation of a pair in sigma: the smaller of
the two ways round, each the distance of one rival's response from the other's tangent space. Both rivals of a pair
stand where a fit to the usual program confuses them most.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softrl.excite.block import Block, joined
from softrl.excite.rival import Rival
from softrl.excite.separation import Normal, Sensing, normal, refitted, responses, tangent


class Pair(NamedTuple):
    """Two rivals and the scaled points (p,) at which they resemble each other under the usual program."""

    first: Rival
    second: Rival
    point_first: np.ndarray
    point_second: np.ndarray

    @property
    def name(self) -> str:
        """Both labels, as in metric names."""
        return f"{slug(self.first.label)}_{slug(self.second.label)}"


@dataclass(frozen=True)
class Effort:
    """How hard to search.

    Attributes
    ----------
    shortlist : candidates that are simulated in place, after all were ranked by the sums of their own responses
    exchanges : rounds in which every block may be exchanged
    fit_evaluations : of each refit
    """

    shortlist: int
    exchanges: int
    fit_evaluations: int


def slug(label: str) -> str:
    """Return a label as it stands in the name of a metric."""
    return "".join(c if c.isalnum() else "_" for c in label.replace("+", "_and_")).strip("_")


def pairs_of(rivals: Sequence[Rival], usual: np.ndarray, sensing: Sensing, effort: Effort) -> list[Pair]:
    """Return all pairs; the second of each is fitted to the first one's response to the program ``usual``."""
    found = []
    for first, second in itertools.combinations(rivals, 2):
        target = responses([first.at(first.point)], usual, sensing)[0]
        point, _ = refitted(second, second.point, target, usual, sensing, effort.fit_evaluations)
        found.append(Pair(first, second, first.point, point))
    return found


def sums(pair: Pair, pressure: np.ndarray, sensing: Sensing) -> tuple[Normal, Normal]:
    """Return the sums of both ways round: first against second's tangent space, and second against first's."""
    one = tangent(pair.first, pair.point_first, pressure, sensing)
    other = tangent(pair.second, pair.point_second, pressure, sensing)
    return normal(one.response, other), normal(other.response, one)


def separation(both: tuple[Normal, Normal]) -> float:
    """Return the separation in sigma: the smaller way round."""
    return min(part.distance() for part in both)


def score(separations: Sequence[float]) -> float:
    """Return the score of a program; its logarithm looks after the pair that is told apart worst."""
    return float(np.sum(np.log1p(np.square(separations))))


def plan(
    pairs: Sequence[Pair], candidates: Sequence[Block], sensing: Sensing, budget_s: float, effort: Effort
) -> list[Block]:
    """Return the blocks, in order, that together last at most ``budget_s`` and tell the pairs apart best.

    Greedy: the candidates that promise most per second, judged by adding up sums of responses from rest, are simulated
    at the end of the program so far, and the best stays. Then each block is exchanged for another as long as that
    helps. No random numbers.
    """
    lengths = [sensing.dt_s * len(block.pressure) for block in candidates]
    alone = [[sums(pair, block.pressure, sensing) for pair in pairs] for block in candidates]
    chosen: list[int] = []
    reached = 0.0
    while True:
        free = budget_s - sum(lengths[k] for k in chosen)
        ranked = _ranked(chosen, [k for k in range(len(candidates)) if lengths[k] <= free], alone, lengths)
        trials = [(_score([*chosen, k], candidates, pairs, sensing), k) for k in ranked[: effort.shortlist]]
        if not trials:
            break
        best, k = max(trials, key=lambda trial: (trial[0] - reached) / lengths[trial[1]])
        if best <= reached and chosen:
            break
        chosen, reached = [*chosen, k], best
    for _ in range(effort.exchanges):
        before = reached
        for place in range(len(chosen)):
            others = chosen[:place] + chosen[place + 1 :]
            free = budget_s - sum(lengths[k] for k in others)
            fitting = [k for k in range(len(candidates)) if lengths[k] <= free and k != chosen[place]]
            for k in _ranked(others, fitting, alone, None)[: effort.shortlist]:
                trial = [*chosen[:place], k, *chosen[place + 1 :]]
                value = _score(trial, candidates, pairs, sensing)
                if value > reached:
                    chosen, reached = trial, value
        if reached <= before:
            break
    return [candidates[k] for k in chosen]


def _ranked(
    chosen: Sequence[int],
    fitting: Sequence[int],
    alone: Sequence[Sequence[tuple[Normal, Normal]]],
    lengths: Sequence[float] | None,
) -> list[int]:
    """Return ``fitting``, best first, by what each adds to ``chosen``: per second, or in all without ``lengths``."""
    count = len(alone[0]) if alone else 0

    def value(numbers: Sequence[int]) -> float:
        if not numbers:
            return 0.0
        separations = []
        for pair in range(count):
            first, second = alone[numbers[0]][pair]
            for k in numbers[1:]:
                first, second = first + alone[k][pair][0], second + alone[k][pair][1]
            separations.append(separation((first, second)))
        return score(separations)

    base = value(chosen)
    gains = {k: (value([*chosen, k]) - base) / (lengths[k] if lengths else 1.0) for k in fitting}
    return sorted(gains, key=lambda k: -gains[k])


def _score(numbers: Sequence[int], candidates: Sequence[Block], pairs: Sequence[Pair], sensing: Sensing) -> float:
    pressure = joined([candidates[k] for k in numbers])
    return score([separation(sums(pair, pressure, sensing)) for pair in pairs])


def refitted_separation(pair: Pair, pressure: np.ndarray, sensing: Sensing, effort: Effort) -> float:
    """Return the separation of a pair under ``pressure`` after full refits, each rival to the other's response."""
    ways = (
        (pair.first, pair.point_first, pair.second, pair.point_second),
        (pair.second, pair.point_second, pair.first, pair.point_first),
    )
    left = []
    for truth, at_truth, rival, at_rival in ways:
        target = responses([truth.at(at_truth)], pressure, sensing)[0]
        left.append(refitted(rival, at_rival, target, pressure, sensing, effort.fit_evaluations)[1])
    return min(left)
