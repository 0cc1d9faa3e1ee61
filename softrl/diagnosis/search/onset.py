"""From which moment on an effect may act for good: a hose that came loose, a camera that was knocked, and stayed so."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.fitting.choices import may_be_gated
from softrl.diagnosis.fitting.hypothesis import Choice, Gate
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, parallel
from softrl.diagnosis.search.look import Base, bases_of
from softrl.diagnosis.search.partly import pieces_of

PIECES = 48  # into which the time of all runs is cut
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
    moments = _moments(fitting)
    ends = np.linspace(moments[0], moments[-1], PIECES + 1)[1:-1]
    piece = np.searchsorted(ends, moments, side="right")
    jobs = [(fitting, base, choice, piece) for choice in able]
    found = parallel(_best_onset, jobs, search.workers)
    best = sorted(zip(able, found, strict=True), key=lambda pair: -pair[1][1])[:LIKELY]
    return [
        choice._replace(gate=Gate("since_s", float(ends[first - 1])), lasting="ever")
        for choice, (first, saved) in best
        if saved > 0.0
    ]


def _moments(fitting: Problem) -> np.ndarray:
    """Return about when each bin (bins,) was recorded, s, all runs one after another."""
    begins = [fitting.numerics.bin_s * bins.places for bins in fitting.bins]
    return np.concatenate([run.gone_s[-1] + within for run, within in zip(fitting.runs, begins, strict=True)])


def _best_onset(fitting: Problem, base: Base, choice: Choice, piece: np.ndarray) -> tuple[int, float]:
    """Return the piece from which on the effect seems to save most, never the first, and how much."""
    pieces = pieces_of(fitting, base, choice, piece)
    numbers = np.arange(len(pieces.slope))
    saved = [pieces.saved(numbers >= first) for first in numbers[1:]]
    best = int(np.argmax(saved))
    return best + 1, float(saved[best])
