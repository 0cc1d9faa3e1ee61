"""Which cases are tried: strata, hidden laws, nuisances, all from one seed."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from softrl.proof.generator.catalogue import CONCEALED, OUTSIDE, PAIRS, RIGHT

LEVELS = (0.3, 1.5, 5.0, 15.0)  # rms of a hidden effect over the noise floor, from undetectable to plain
STRATA = ("null", "nuisance", "single", "pair", "concealed", "outside")


@dataclass(frozen=True)
class Case:
    """One trial before its recordings are made.

    Attributes
    ----------
    number, stratum : which
    entries : (name, place) of the hidden laws
    level : target of the signal-to-noise ratio of each; zero for none
    measured_pressure : whether the chambers' pressures are recorded
    seed : of everything else in the case
    """

    number: int
    stratum: str
    entries: tuple[tuple[str, str], ...]
    level: float
    measured_pressure: bool
    seed: int


def shares(cases: int) -> dict[str, int]:
    """Return how many cases each stratum gets: at least 30 % without an effect, at least 15 % outside the library."""
    null = ceil(0.30 * cases)
    outside = ceil(0.15 * cases) if cases > 1 else 0
    left = max(cases - null - outside, 0)
    pair, concealed = round(0.25 * left), round(0.2 * left)
    return {
        "null": null - null // 2,
        "nuisance": null // 2,
        "single": left - pair - concealed,
        "pair": pair,
        "concealed": concealed,
        "outside": outside,
    }


def plan(cases: int, seed: int) -> list[Case]:
    """Return the cases in random order; every entry and level comes up before any comes up again."""
    rng = np.random.default_rng(seed)
    made: list[tuple[str, tuple[tuple[str, str], ...], float]] = []
    counts = shares(cases)
    singles = _dealt(sorted(RIGHT), counts["single"], rng)
    levels = _dealt(LEVELS, counts["single"], rng)
    for stratum in ("null", "nuisance"):
        made += [(stratum, (), 0.0)] * counts[stratum]
    made += [("single", ((name, "everywhere"),), level) for name, level in zip(singles, levels, strict=True)]
    made += [("pair", tuple((name, "everywhere") for name in pair), float(rng.uniform(4.0, 10.0)))
             for pair in _dealt(PAIRS, counts["pair"], rng)]  # fmt: skip
    made += [
        ("concealed", (entry,), float(rng.uniform(3.0, 10.0))) for entry in _dealt(CONCEALED, counts["concealed"], rng)
    ]
    made += [("outside", ((name, "everywhere"),), float(rng.uniform(4.0, 12.0)))
             for name in _dealt(sorted(OUTSIDE), counts["outside"], rng)]  # fmt: skip
    order = rng.permutation(len(made))
    return [
        Case(number, *made[k], bool(rng.uniform() < 0.5) and made[k][0] != "concealed", int(rng.integers(2**31)))
        for number, k in enumerate(order)
    ]


def _dealt(deck: Sequence[Any], count: int, rng: np.random.Generator) -> list[Any]:
    """Return ``count`` cards, the whole deck dealt before it is shuffled again."""
    hand: list[Any] = []
    while len(hand) < count:
        hand += [deck[k] for k in rng.permutation(len(deck))]
    return hand[:count]
