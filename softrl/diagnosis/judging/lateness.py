"""How late a log is, in words: no physics, but whoever reads on should know."""

import math
from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.judging.examine import Finding, Named
from softrl.recordings.acting import ACTS

SHAPELESS = 2.0  # rows: over less than these a spread hardly has a shape
LATE_SHARE = 0.2  # of the interval between samples: a log that is less late goes without saying


def lateness(findings: Sequence[Finding]) -> list[str]:
    """Return how late commands act by the log, and how late the motion is seen, where it counts beside the interval."""
    shifts = [line for finding in findings for line in _of_shifts(finding)]
    motions = [line for finding in findings[1:] for line in _of_motion(finding)]
    spread = [line for finding in findings for named in finding.named for line in _of_spread(finding, named)]
    return [*_of_clock(findings[0]), *_of_commands(findings[0]), *motions, *shifts, *spread]


def _of_clock(finding: Finding) -> list[str]:
    later, interval_s = finding.part.problem.later, finding.part.problem.interval_s
    if not later:
        return []
    times = np.concatenate(list(later.values()))
    apart_s = float(np.ptp(times[times != 0.0]))  # before a run's first move nothing is late
    return [
        f"Commands were sent by another clock than the log's: behind their rows some moves of the pressures come up to "
        f"{1e3 * apart_s:.2g} ms later than others, of {1e3 * interval_s:.2g} ms between rows. Taken as how the log is written, "
        "with one time free for each move, also where errors are told; a valve that holds a move back for less than a row would "
        "show so, too. Write a row when a command is sent, to tell."
    ]


def _of_shifts(finding: Finding) -> list[str]:
    interval_s = finding.part.problem.late_max_s
    shifts = [named.choice.label() for named in finding.named if named.choice.shifts_time]
    if interval_s == 0.0:
        return [
            f"{label} rests on the dataset's {ACTS}: were that wrong, up to {1e3 * _row_s(finding):.2g} ms of it would be how "
            "rows are written."
            for label in shifts
        ]
    return [
        f"{label} holds what the log is late by, too: up to {1e3 * interval_s:.2g} ms of it, the interval between rows, may be "
        "how rows are written."
        for label in shifts
    ]


def _of_spread(finding: Finding, named: Named) -> list[str]:
    """Return what a dead time is whose arrivals are spread over hardly more than a row: rows cannot show their shape."""
    told = {interval.name: interval.value for interval in named.intervals}
    spread_s = math.sqrt(told.get("dispersion", 0.0)) * told.get("delay_s", 0.0)
    row_s = _row_s(finding)
    if not 0.0 < spread_s < SHAPELESS * row_s:
        return []
    return [
        f"{named.choice.label()} spreads what arrives over {1e3 * spread_s:.2g} ms, of which rows {1e3 * row_s:.2g} ms apart "
        "hardly show the shape: it may as well be a lag with that time constant behind a dead time that is shorter by as much."
    ]


def _row_s(finding: Finding) -> float:
    return float(np.median([np.median(np.diff(run.time)) for run in finding.part.problem.runs]))


def _of_commands(finding: Finding) -> list[str]:
    late_s, interval_s = _late_of(finding)
    if late_s < LATE_SHARE * interval_s or interval_s == 0.0:
        return []
    if late_s > (1.0 - LATE_SHARE) * interval_s:
        return ["By the log each row's command acts from its time until the next row's."]
    return [
        f"By the log each row's command acts until {1e3 * late_s:.2g} ms after its time, of {1e3 * interval_s:.2g} ms "
        "between rows: taken as how the log is written, not as physics."
    ]


def _of_motion(finding: Finding) -> list[str]:
    late_s, interval_s = _late_of(finding)
    if late_s < LATE_SHARE * interval_s or interval_s == 0.0:
        return []
    return [
        f"The motion comes {1e3 * late_s:.2g} ms behind the pressures of its row: taken as how the log is written, though a "
        "tracker that is late by less than a row would show so, too."
    ]


def _late_of(finding: Finding) -> tuple[float, float]:
    """Return how late the log is, s, and the interval between its samples."""
    problem, final = finding.part.problem, finding.final
    return problem.space(final.hypothesis).late(final.fit.point), problem.late_max_s
