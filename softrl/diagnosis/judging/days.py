"""Sessions that differ a little in themselves: a base that is mounted anew, a wall as stiff as the day is warm.

No simulator of one robot predicts that, and no law names it. Where it is all that is left, nothing else is missing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrl.diagnosis.fitting.bodies import STIFFNESS
from softrl.diagnosis.fitting.problem import MOUNT_SHIFT_SHARE, MOUNT_TURN_RAD, ORIENTATION_LEVER, Problem
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.fitting.varied import slopes
from softrl.diagnosis.judging.examine import Day, Days, Finding
from softrl.diagnosis.judging.leftover import explained_by, not_understood, offer_of

STIFFER = 0.03  # of the wall: more is no detail of a day
MOSTLY = 0.5  # of the squared error that stays
TURNS, SHIFTS, STIFFENS = slice(0, 3), slice(3, 6), 6  # numbers of a day
SHRINK = 1e-9  # of a column's mean square: no motion turns about its own line


def by_days(finding: Finding) -> Finding:
    """Return the ``finding`` as understood where all that makes it unknown is that sessions differ a little in themselves.

    Each may be turned, moved and stiffer by as little as no one avoids from day to day, beside what is the same in all. To first
    order, fitted on a session's runs that fits see, or on its own where it was held out whole. Where it is understood already and
    that is most of what stays, it is told.
    """
    part, judge, trial = finding.part, finding.judge, finding.final
    sessions = dict.fromkeys(run.session for run in (*part.problem.runs, *judge.problem.runs))
    if len(sessions) < 2 or not (finding.unknown or finding.left > judge.material):
        return finding
    sides = [_Side(problem, trial) for problem in (part.problem, judge.problem)]
    found = _little(sides, sessions)
    if found is None:
        return finding
    training, heldout = (side.without(found.apart) for side in sides)
    together, each = sides[1].left(found.alike), sides[1].left(found.apart)
    if judge.gap(together, each).low <= 0.0 or judge.removed(together, each) <= judge.material:
        return finding
    left = float(judge.excess(each.mean()))
    if not finding.unknown:
        told = Days(found.days, left, beside=True)
        return replace(finding, days=told) if left**2 < (1.0 - MOSTLY) * finding.left**2 else finding
    by_itself, mine = replace(judge, problem=heldout), trial._replace(squares=each)
    offer = offer_of(training, by_itself, mine)
    if not_understood(training, by_itself, mine, offer, explained_by(judge, finding.base, mine, offer)):
        return finding
    return replace(finding, unknown=False, reasons=[], closest="", days=Days(found.days, left))


def mounted_apart(finding: Finding) -> bool:
    """Return whether sessions seem to be mounted a little otherwise each, by what the ``finding`` leaves.

    All of them may be turned and moved alike, which is another matter.
    """
    both = finding.judge.on((*finding.part.problem.runs, *finding.judge.problem.runs))
    sessions = dict.fromkeys(run.session for run in both.problem.runs)
    if both.problem.register or both.problem.mounted or both.problem.robot.output == "bend_angle" or len(sessions) < 2:
        return False
    side = _Side(both.problem, finding.final, mounts_only=True)
    found = _little([side], sessions)
    return found is not None and both.shows(side.left(found.alike), side.left(found.apart))


def stiffer_on(finding: Finding) -> dict[str, float]:
    """Return by session the share by which the wall is stiffer that day, where the ``finding`` is that days differ."""
    return {day.session: day.stiffer for day in finding.days.each} if finding.days else {}


def says_more(again: Finding, before: Finding) -> bool:
    """Return whether what was found ``again``, with bases placed, leaves plainly less than that days differ, if that was said."""
    return before.days is None or before.days.left**2 - again.left**2 > again.judge.material**2


def told_of_days(findings: Sequence[Finding]) -> list[str]:
    """Return in words how far sessions differ in themselves, where they do."""
    found = [day for finding in findings if finding.days for day in finding.days.each]
    each = [
        f"{day.session} by {100.0 * day.stiffer:+.2g} % in stiffness, {np.degrees(day.turn_rad):.2g} deg and "
        f"{1e3 * day.shift_m:.2g} mm of the base"
        for day in found
    ]
    return [f"Against all together sessions differ a little in themselves: {'; '.join(each)}."] if each else []


class _Side:
    """The runs of a problem with what a trial leaves of them, and what it would leave on another day."""

    def __init__(self, problem: Problem, trial: Trial, mounts_only: bool = False) -> None:
        self.problem, self.trial = problem, trial
        self.residual = problem.residual(trial.hypothesis, trial.fit.point, trial.placed)
        stiffer = [np.zeros_like(left) for left in self.residual.runs] if mounts_only else self._stiffer()
        self.columns = [self._columns(k, rows) for k, rows in enumerate(stiffer)]

    def session_of(self, number: int) -> str:
        """Return the session of a run."""
        return self.problem.runs[number].session

    def rows(self, session: str | None) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return columns (rows, 7) and residual (rows,) of every run of a ``session``, or of all."""
        return [
            (self.columns[k], left.ravel()) for k, left in enumerate(self.residual.runs) if session in (None, self.session_of(k))
        ]

    def without(self, numbers: dict[str, np.ndarray]) -> Problem:
        """Return the problem on days that differ by as much as ``numbers`` (7,) say, by session."""
        shift = [
            -(self.columns[k] @ numbers[self.session_of(k)]).reshape(left.shape) for k, left in enumerate(self.residual.runs)
        ]
        before = self.problem.defect or [np.zeros(left.shape) for left in self.residual.runs]
        return replace(self.problem, defect=tuple(a + b for a, b in zip(before, shift, strict=True)))

    def left(self, numbers: dict[str, np.ndarray]) -> np.ndarray:
        """Return the squared errors (bins,) on such days."""
        return self.without(numbers).residual(self.trial.hypothesis, self.trial.fit.point, self.trial.placed).squares

    def _stiffer(self) -> list[np.ndarray]:
        """Return what is seen beyond the simulation (bins, channels) a run where the wall is stiffer, per share of that."""
        tuned = self.trial.hypothesis.tuned
        first = len(self.trial.fit.point) - len(tuned)
        stiff = [first + k for k, name in enumerate(tuned) if name.endswith(STIFFNESS)]
        return [-part[:, :, stiff].sum(axis=2) for part in slopes(self.problem, self.trial, self.residual)]

    def _columns(self, number: int, stiffer: np.ndarray) -> np.ndarray:
        """Return (rows, 7): what is seen beyond the simulation where the base is turned, moved, and the wall ``stiffer``."""
        run, bins = self.problem.runs[number], len(stiffer)
        found = np.zeros((bins, stiffer.shape[1], 7))
        found[:, :, STIFFENS] = stiffer
        if run.position is None or stiffer.shape[1] == 1:
            found[:, :, 0] = self.problem.robot.length_m
            return found.reshape(-1, 7)
        tip, turned = self.problem.binned(number, run.position), np.eye(3)
        for axis in range(3):
            found[:, :3, axis] = np.cross(turned[axis], tip)
            found[:, axis, 3 + axis] = 1.0
            if stiffer.shape[1] > 3:
                found[:, 3 + axis, axis] = ORIENTATION_LEVER * self.problem.robot.length_m
        return found.reshape(-1, 7)


class _Little(NamedTuple):
    """Numbers (7,) of all sessions together and each one's own, by session, and how far these are from those."""

    alike: dict[str, np.ndarray]
    apart: dict[str, np.ndarray]
    days: tuple[Day, ...]


def _little(sides: Sequence[_Side], sessions: Iterable[str]) -> _Little | None:
    """Return how sessions differ, each by the first of ``sides`` that holds runs of it; None where one differs by much."""
    rows = {name: next(filter(None, (side.rows(name) for side in sides))) for name in sessions}
    alike, apart = _solved(sides[0].rows(None)), {name: _solved(mine) for name, mine in rows.items()}
    days = tuple(_day(name, own - alike) for name, own in apart.items())
    length_m = sides[0].problem.robot.length_m
    return _Little(dict.fromkeys(apart, alike), apart, days) if all(_is_little(day, length_m) for day in days) else None


def _solved(rows: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the numbers (7,) of a day by least squares."""
    columns, left = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    normal = columns.T @ columns
    return np.linalg.lstsq(normal + SHRINK * np.diag(np.diag(normal)), columns.T @ left, rcond=None)[0]


def _day(session: str, numbers: np.ndarray) -> Day:
    return Day(session, float(numbers[STIFFENS]), float(np.linalg.norm(numbers[TURNS])), float(np.linalg.norm(numbers[SHIFTS])))


def _is_little(day: Day, length_m: float) -> bool:
    return abs(day.stiffer) < STIFFER and day.turn_rad < MOUNT_TURN_RAD and day.shift_m < MOUNT_SHIFT_SHARE * length_m
