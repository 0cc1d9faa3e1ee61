"""How much of the recordings fits see."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.checks.gaps import rows
from softrl.diagnosis.fitting.problem import MIN_FOLDS
from softrl.recordings.lost import is_seen
from softrl.recordings.recording import Recording
from softrl.recordings.validate import SLOW_S

LEAST_S = 15.0  # fits rather see fewer runs than shorter pieces
ROUNDED = 1e-9  # of a length: a run that stays whole keeps its last row, however its times are rounded


def within(runs: Sequence[Recording], seconds: float) -> tuple[Recording, ...]:
    """Return runs that together last at most ``seconds``, cut at one common length; all start as recorded, and show motion.

    Where that would leave less than ``LEAST_S`` of each, the runs that were driven most are taken, one of every session
    before a second of any: slow effects do not show in many short pieces. A run's rows more than ``SLOW_S`` apart count as if
    they were ``SLOW_S`` apart, or hardly any would be left.
    """
    runs, count = list(runs), max(int(seconds / LEAST_S), MIN_FOLDS)
    if _common_length(runs, seconds) < LEAST_S and len(runs) > count:
        drive = [float(np.sum(np.std(run.pressure_cmd[run.time < _after(run, LEAST_S)], axis=0))) for run in runs]
        turn: dict[str, int] = {}
        order = []
        for k in sorted(range(len(runs)), key=lambda k: -drive[k]):
            turn[runs[k].session] = turn.get(runs[k].session, 0) + 1
            order.append((turn[runs[k].session], -drive[k], k))
        chosen = sorted(k for _, _, k in sorted(order)[:count])
        runs = [runs[k] for k in chosen]
    length = _common_length(runs, seconds)
    ends = [int(np.searchsorted(run.time, _after(run, (1.0 + ROUNDED) * length), side="right")) for run in runs]
    pieces = tuple(rows(run, slice(end)) for run, end in zip(runs, ends, strict=True))
    return tuple(filter(is_seen, pieces)) or pieces


def _slower(run: Recording) -> float:
    """Return how many seconds of a run count as one."""
    return max(float(np.median(np.diff(run.time))) / SLOW_S, 1.0)


def _after(run: Recording, counted_s: float) -> float:
    """Return the time, s, until which ``counted_s`` of a run count."""
    return float(run.time[0]) + _slower(run) * counted_s


def _common_length(runs: Sequence[Recording], seconds: float) -> float:
    """Return the length, s that count, at which runs are cut so that together they last at most ``seconds``."""
    lengths = np.sort([np.ptp(run.time) / _slower(run) for run in runs])
    if lengths.sum() <= seconds:
        return float(lengths[-1])
    # shorter runs stay whole, and the others share what those leave
    shares = (seconds - (np.cumsum(lengths) - lengths)) / np.arange(len(lengths), 0, -1)
    return float(shares[np.argmax(shares < lengths)])
