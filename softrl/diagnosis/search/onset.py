"""From which moment on an effect may act, as far as straight lines tell: a hose that came loose, a camera that was knocked."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from softrl.diagnosis.fitting.choices import may_be_gated
from softrl.diagnosis.fitting.effort import parallel
from softrl.diagnosis.fitting.hypothesis import LASTING, Choice, Gate
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial
from softrl.diagnosis.search.look import Base, bases_of
from softrl.diagnosis.search.partly import pieces_of
from softrl.effects.library import effect_class

PIECES = 48  # into which the time that a clock goes on is cut
ALIKE = 1e-6  # of what the best moment saves: where nothing moves, as much is saved from many moments on
LIKELY = 6  # effects that are looked at further, the first by what straight lines tell


def for_good(fitting: Problem, current: Trial, choices: Sequence[Choice], search: Search) -> list[Choice]:
    """Return the likeliest of ``choices`` as they would act from some moment on in all runs to come.

    A run that follows has to show it: with one run alone, a time of each run says the same.
    """
    able = [choice for choice in choices if "since_s" in may_be_gated(choice) and not (choice.sessions or choice.lasting)]
    if len(fitting.runs) < 2 or not able:
        return []
    fitting = fitting.rough_about(current.hypothesis, current.fit.point)
    base = bases_of(fitting, current)[0]
    gone = moments(fitting, "ever")
    found = parallel(_best_onset, [(fitting, base, choice, gone) for choice in able], search.workers)
    best = sorted(zip(able, found, strict=True), key=lambda pair: -pair[1].saved)[:LIKELY]
    return [
        choice._replace(gate=Gate("since_s", onset.moment_s), lasting="ever") for choice, onset in best if onset.saved > 0.0
    ]


def onsets(
    fitting: Problem, bases: Sequence[Base], choices: Sequence[Choice], search: Search
) -> dict[Choice, list[dict[str, float]]]:
    """Return when, s by its own clock, each of ``choices`` that is another effect from its onset on seems to begin.

    That is seen from every base; a fit that begins far too early does not come to the right moment.
    """
    begun = [choice for choice in choices if effect_class(choice.name).onset_of]
    pairs = [(choice, base) for choice in begun for base in bases]
    jobs = [(fitting, base, _always(c), moments(fitting, c.lasting, c.sessions)) for c, base in pairs]
    found: dict[Choice, list[dict[str, float]]] = {}
    for (choice, _), onset in zip(pairs, parallel(_best_onset, jobs, search.workers), strict=True):
        found.setdefault(choice, []).append({"onset_s": onset.moment_s})
    return found


def _always(choice: Choice) -> Choice:
    """Return what ``choice`` is after its onset."""
    return choice._replace(name=effect_class(choice.name).onset_of, pinned=(), gate=None, sessions=(), lasting="")


def moments(fitting: Problem, lasting: str, sessions: Collection[str] = ()) -> np.ndarray:
    """Return about when each bin (bins,) was recorded, s by the clock of what is ``lasting``; never outside its ``sessions``."""
    clock = ("", *LASTING).index(lasting)
    within = [fitting.numerics.bin_s * bins.places for bins in fitting.bins]
    acts = [not sessions or run.session in sessions for run in fitting.runs]
    gone = [run.gone_s[clock] if may else -np.inf for run, may in zip(fitting.runs, acts, strict=True)]
    return np.concatenate([begun + bins for begun, bins in zip(gone, within, strict=True)])


class _Onset(NamedTuple):
    """A moment, s, and what of the squared error an effect seems to save that acts from then on."""

    moment_s: float
    saved: float


def _best_onset(fitting: Problem, base: Base, choice: Choice, gone: np.ndarray) -> _Onset:
    """Return the first moment from which on the effect, which acts everywhere, seems to save most; never the beginning."""
    acts = gone[np.isfinite(gone)]
    ends = np.linspace(acts.min(), acts.max(), PIECES + 1)[1:-1]
    pieces = pieces_of(fitting, base, choice, np.searchsorted(ends, gone, side="right"))
    numbers = np.arange(PIECES)
    saved = np.array([pieces.saved(numbers >= first) for first in numbers[1:]])
    best = int(np.argmax(saved >= saved.max() - ALIKE * abs(saved.max())))
    return _Onset(float(ends[best]), float(saved[best]))
