"""How long a search may take, told before it begins where that is long."""

import logging
import time
from dataclasses import replace

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.checks.gaps import rows
from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.problem import Problem

log = logging.getLogger(__name__)
REPLAYS = 4000  # of all runs that fits see; searches of the whole library took up to twenty thousand
PROBES_S = (0.2, 2.0, 20.0)  # of motion that are timed: the first that takes longer than ``TOLD_S``, and than what goes with it
TOLD_S = 0.1
LONG_S = 3600.0


def expected_s(body: Problem, workers: int) -> float:
    """Return how long a search of the whole library takes at least, s, by a short piece of the first run as it begins to move.

    Nought where the body does not bear to begin there.
    """
    first = body.runs[0]
    moving = int(np.argmax(np.any(first.pressure_cmd != first.pressure_cmd[0], axis=1)))  # a body at rest costs nothing
    begin = min(moving, len(first.time) - 2)
    for probe_s in PROBES_S:
        end = int(np.searchsorted(first.time, first.time[begin] + probe_s, side="right"))
        piece = rows(first, slice(begin, max(end, begin + 2)))
        at_once = replace(body.on((piece,)), numerics=replace(body.numerics, settle_s=0.0))
        try:
            took = min(_replay_s(replace(at_once)) for _ in range(2))  # the first one may compile
        except SolverError:
            return 0.0
        if took > TOLD_S:
            break
    whole = sum(float(np.ptp(run.time)) for run in body.runs)
    return REPLAYS * took * whole / float(np.ptp(piece.time)) / workers


def warn_of_cost(body: Problem, workers: int) -> None:
    """Warn where a search would take longer than anybody waits, as with a simulator that is not made to be replayed."""
    if (seconds := expected_s(body, workers)) > LONG_S:
        log.warning(
            "with %s a search of all effects takes %.0f hours or more; simulator=rom (stage=pod) and simulator=pcc are made for "
            "it, fewer stage.candidates and a smaller stage.search.fit_s shorten it",
            type(body.simulator).__name__,
            seconds / 3600.0,
        )


def _replay_s(body: Problem) -> float:
    began = time.perf_counter()
    body.replayed(Hypothesis((), ()), np.zeros(0))
    return time.perf_counter() - began
