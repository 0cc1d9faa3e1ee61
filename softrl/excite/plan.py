"""Choose the blocks that tell rivals apart best within a time budget: a pure function of rivals and blocks.

The score of a program is ``sum over pairs of log(1 + D^2)`` with D the separation of a pair in sigma: the smaller of
the two ways round, each the distance of one rival's response from the other's tangent space. Both rivals of a pair
stand where a fit to the usual program confuses them most.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from softrl.excite.block import Block, joined
from softrl.excite.rival import Rival
from softrl.excite.separation import Normal, Sensing, normal, refitted, responses, tangent
from softrl.recordings.program import limited
from softrl.robots.robot import Robot

PIECE_S = 0.5  # grid of places at which a piece may be put into a program
QUICK_FIT = 3  # evaluations of a rival that follows a growing program
CONVERGED = 100  # evaluations of a refit that is reported: it ends by itself before


class Way(NamedTuple):
    """One way round: a rival at scaled parameters (p,) is the truth, another one searches for it from its own."""

    truth: Rival
    at_truth: np.ndarray
    rival: Rival
    at_rival: np.ndarray


class Pair(NamedTuple):
    """Two rivals, both ways round: the first one is the truth, then the second one is."""

    ways: tuple[Way, Way]

    @property
    def labels(self) -> tuple[str, str]:
        """What both are called."""
        return self.ways[0].truth.label, self.ways[1].truth.label

    @property
    def name(self) -> str:
        """Both labels, as in metric names."""
        return "_".join(slug(label) for label in self.labels)


@dataclass(frozen=True)
class Effort:
    """How hard to search.

    Attributes
    ----------
    shortlist : candidates that are simulated in place, after all were ranked by the sums of their own responses
    exchanges : rounds in which every block may be exchanged
    proposals : pieces that are tried at random places of the best program, and kept where refits say they help
    repeats : times that a block may stand in a program; what a repeat adds is noise averaged out, and models err alike
    fit_evaluations : of each refit of the search; what is reported, and chosen by at last, is refitted to its end
    """

    shortlist: int
    exchanges: int
    repeats: int
    proposals: int
    fit_evaluations: int


def slug(label: str) -> str:
    """Return a label as it stands in the name of a metric."""
    return "".join(c if c.isalnum() else "_" for c in label.replace("+", "_and_")).strip("_")


def pairs_of(rivals: Sequence[Rival], usual: np.ndarray, sensing: Sensing, effort: Effort) -> list[Pair]:
    """Return all pairs; the second of each is fitted to the first one's response to the program ``usual``."""
    found = []
    for first, second in itertools.combinations(rivals, 2):
        start = Way(first, first.point, second, second.point)
        fitted = pursued(start, usual, sensing, effort.fit_evaluations)[0].at_rival
        found.append(Pair((Way(first, first.point, second, fitted), Way(second, fitted, first, first.point))))
    return found


def pursued(way: Way, pressure: np.ndarray, sensing: Sensing, evaluations: int) -> tuple[Way, float]:
    """Return ``way`` with the rival as close to the truth as it comes under a program, and the distance left in sigma."""
    target = responses([way.truth.at(way.at_truth)], pressure, sensing)[0]
    point, left = refitted(way.rival, way.at_rival, target, pressure, sensing, evaluations)
    return way._replace(at_rival=point), left


def sums(pair: Pair, pressure: np.ndarray, sensing: Sensing) -> tuple[Normal, ...]:
    """Return the sums of both ways round: the truth against the tangent space of its rival."""
    return tuple(
        normal(
            responses([way.truth.at(way.at_truth)], pressure, sensing)[0],
            tangent(way.rival, way.at_rival, pressure, sensing),
        )
        for way in pair.ways
    )


def separation(both: Sequence[Normal]) -> float:
    """Return the separation in sigma: the smaller way round."""
    return min(part.distance() for part in both)


def score(separations: Sequence[float]) -> float:
    """Return the score of a program; its logarithm looks after the pair that is told apart worst."""
    return float(np.sum(np.log1p(np.square(separations))))


def plan(
    pairs: Sequence[Pair], candidates: Sequence[Block], sensing: Sensing, budget_s: float, effort: Effort
) -> list[Block]:
    """Return the blocks, in order, that together last at most ``budget_s``, to half a step, and tell the pairs apart best.

    Notes
    -----
    After Atkinson and Fedorov's exchange of design and rival (no equation number checked). The candidates that promise
    most per second, judged by adding up sums of responses from rest, are simulated at the end of the program so far, and
    the best stays; then the rivals search anew under the longer program, and so on. At last each block is exchanged for
    another as long as that helps. No random numbers.
    """
    lengths = [len(block.pressure) for block in candidates]
    rows = round(budget_s / sensing.dt_s)
    alone = [[sums(pair, block.pressure, sensing) for pair in pairs] for block in candidates]
    chosen: list[int] = []

    def allowed(others: Sequence[int]) -> list[int]:
        free = rows - sum(lengths[k] for k in others)
        return [k for k in range(len(candidates)) if lengths[k] <= free and others.count(k) < effort.repeats]

    while ranked := _ranked(chosen, allowed(chosen), alone, lengths)[: effort.shortlist]:
        reached = _score(chosen, candidates, pairs, sensing)
        gains = [(_score([*chosen, k], candidates, pairs, sensing) - reached) / lengths[k] for k in ranked]
        chosen.append(ranked[int(np.argmax(gains))])
        pressure = joined([candidates[k] for k in chosen])
        pairs = [_pursued_pair(pair, pressure, sensing, QUICK_FIT) for pair in pairs]
    for _ in range(effort.exchanges if chosen else 0):
        reached = before = _score(chosen, candidates, pairs, sensing)
        for place in range(len(chosen)):
            others = chosen[:place] + chosen[place + 1 :]
            for k in _ranked(others, allowed(others), alone, None)[: effort.shortlist]:
                trial = [*chosen[:place], k, *chosen[place + 1 :]]
                value = _score(trial, candidates, pairs, sensing) if k != chosen[place] else reached
                if value > reached:
                    chosen, reached = trial, value
        if reached <= before:
            break
    return [candidates[k] for k in chosen]


@dataclass(frozen=True)
class Program:
    """Pressures and where they come from.

    Attributes
    ----------
    pressure : (steps, chambers) Pa
    labels : what the pieces are called
    piece : (steps,) number of the label of each row
    """

    pressure: np.ndarray
    labels: tuple[str, ...]
    piece: np.ndarray

    def with_piece(self, block: Block, place: int, robot: Robot, dt_s: float) -> "Program":
        """Return the program with rows from ``place`` on replaced by a block; the slew is kept at its ends."""
        end = min(place + len(block.pressure), len(self.pressure))
        pressure, piece = self.pressure.copy(), self.piece.copy()
        pressure[place:end] = block.pressure[: end - place]
        piece[place:end] = len(self.labels)
        return Program(limited(robot, pressure, dt_s), (*self.labels, block.label), piece)

    def segments(self, dt_s: float) -> list[dict[str, Any]]:
        """Return {label, start_s, duration_s} of the pieces that are left, in order."""
        edges = [0, *(np.flatnonzero(np.diff(self.piece)) + 1), len(self.piece)]
        return [
            {"label": self.labels[int(self.piece[a])], "start_s": float(a * dt_s), "duration_s": float((b - a) * dt_s)}
            for a, b in itertools.pairwise(edges)
        ]


def refine(
    pairs: Sequence[Pair],
    candidates: Sequence[Block],
    program: Program,
    robot: Robot,
    sensing: Sensing,
    effort: Effort,
    rng: np.random.Generator,
) -> Program:
    """Return ``program`` with pieces of ``candidates`` put in where rivals, searching anew, stay farther apart.

    The plan follows the rivals' tangents, which promise more than a refit leaves; here each proposal is judged by a few
    steps of the refit itself.
    """
    pairs = [_pursued_pair(pair, program.pressure, sensing, effort.fit_evaluations) for pair in pairs]
    reached = score([_left(pair, program.pressure, sensing) for pair in pairs])
    grid = max(round(PIECE_S / sensing.dt_s), 1)
    for _ in range(effort.proposals):
        piece = candidates[int(rng.integers(len(candidates)))]
        place = grid * int(rng.integers(max((len(program.pressure) - len(piece.pressure)) // grid, 0) + 1))
        trial = program.with_piece(piece, place, robot, sensing.dt_s)
        moved = [_pursued_pair(pair, trial.pressure, sensing, QUICK_FIT) for pair in pairs]
        value = score([_left(pair, trial.pressure, sensing) for pair in moved])
        if value > reached:
            program, pairs, reached = trial, moved, value
    return program


def program_of(chosen: Sequence[Block]) -> Program:
    """Return blocks one after the other as a program."""
    piece = np.repeat(np.arange(len(chosen)), [len(block.pressure) for block in chosen])
    return Program(joined(list(chosen)), tuple(block.label for block in chosen), piece)


def _left(pair: Pair, pressure: np.ndarray, sensing: Sensing) -> float:
    """Return the distance in sigma that is left where the rivals stand, of the way round that leaves less."""
    plants = [plant for way in pair.ways for plant in (way.truth.at(way.at_truth), way.rival.at(way.at_rival))]
    rows = responses(plants, pressure, sensing)
    return float(min(np.linalg.norm(rows[1] - rows[0]), np.linalg.norm(rows[3] - rows[2])))


def _pursued_pair(pair: Pair, pressure: np.ndarray, sensing: Sensing, evaluations: int) -> Pair:
    first, second = (pursued(way, pressure, sensing, evaluations)[0] for way in pair.ways)
    return Pair((first, second))


def _ranked(
    chosen: Sequence[int],
    allowed: Sequence[int],
    alone: Sequence[Sequence[Sequence[Normal]]],
    lengths: Sequence[float] | None,
) -> list[int]:
    """Return ``allowed``, best first, by what each adds to ``chosen``: per second, or in all without ``lengths``."""

    def value(numbers: Sequence[int]) -> float:
        if not numbers:
            return 0.0
        found = []
        for pair in range(len(alone[0])):
            ways = zip(*(alone[k][pair] for k in numbers), strict=True)
            found.append(separation([sum(parts[1:], parts[0]) for parts in ways]))
        return score(found)

    base = value(chosen)
    gains = {k: (value([*chosen, k]) - base) / (lengths[k] if lengths else 1.0) for k in allowed}
    return sorted(gains, key=lambda k: -gains[k])


def _score(numbers: Sequence[int], candidates: Sequence[Block], pairs: Sequence[Pair], sensing: Sensing) -> float:
    if not numbers:
        return 0.0
    pressure = joined([candidates[k] for k in numbers])
    return score([separation(sums(pair, pressure, sensing)) for pair in pairs])


def refitted_separation(pair: Pair, pressure: np.ndarray, sensing: Sensing) -> float:
    """Return the separation of a pair under ``pressure`` after refits to their end, each rival to the other's response."""
    return min(pursued(way, pressure, sensing, CONVERGED)[1] for way in pair.ways)
