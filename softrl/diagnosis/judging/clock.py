"""A log by another clock than the commands': every move of the pressures began somewhat earlier or later than its row has it.

A program that sends commands by its own clock, beside a logger that writes what it finds, shows each move up to a row late. A
lag or a dead time is the same for all moves; this is another for each, and may be told apart from physics only where nothing
in the library explains what it leaves.
"""

from dataclasses import dataclass, replace

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem, Residual
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.fitting.varied import slopes
from softrl.diagnosis.judging.examine import Finding
from softrl.recordings.recording import Recording

MOVE = 0.1  # share of a run's largest step between rows: a smaller one begins no response of its own
FEW = 8  # moves, of all runs: fewer say nothing about a clock
ROUNDS, SHARES = 3, (1.0, 0.5, 0.25)  # of Gauss and Newton, and of their step, the first that helps
QUIET = 1e-3  # of what counts: recordings without any noise are weighed as if they had so much
ALIKE = 0.1  # scaled units by which parameters are wrong for the clock alone
DIFFERENCE = 0.05  # of a row, for derivatives
WITHIN = 0.75  # rows by which moves are early or late: half a row about their middle, and what a time is wrong by
MOSTLY = 0.95  # of all moves are within that
HELPS = 0.8  # of the error above the noise: what remains where the clock explains it, at most


def sent_later(finding: Finding) -> dict[str, np.ndarray]:
    """Return by run how much later (rows,) s than the log has it each row's command was sent.

    Empty unless nearly all moves come within a row of each other by the log, and that explains much of what the finding leaves
    on the runs of the fits and on those that judge.

    Notes
    -----
    One time for each move until the next, with the variance ``interval^2 / 12`` of a time that is even within a row beforehand,
    beside small changes of all that is free: regularised least squares on what is left about its mean in each hold, for how a
    robot stands between moves tells nothing of times (no equation number checked).
    """
    judge = finding.judge.on((*finding.part.problem.runs, *finding.part.heldout))
    if judge.problem.drive != "command" or judge.problem.interval_s <= 0.0:
        return {}
    clock = _Clock(judge, [_moves(run) for run in judge.problem.runs])
    times = clock.punctual
    if sum(map(len, times)) < FEW:
        return {}
    trial, before = finding.final, clock.error(finding.final, times)
    error = before
    for _ in range(ROUNDS):
        try:
            towards = clock.towards(trial, times)
        except SolverError:
            break
        for share in SHARES:
            there = clock.moved(trial, times, towards, share)
            if (less := clock.error(*there)) < error:
                (trial, times), error = there, less
                break
    every = np.concatenate(times) / judge.problem.interval_s
    apart = np.abs(every - np.median(every))
    if error > HELPS * before or np.mean(apart <= WITHIN) < MOSTLY:
        return {}
    return clock.later(times)


@dataclass(frozen=True)
class _Clock:
    """Rows (moves,) of every run with which moves begin, beside a judge of all runs."""

    judge: Judge
    moves: list[np.ndarray]

    @property
    def punctual(self) -> list[np.ndarray]:
        """Times (moves,) s of moves that come when the log says."""
        return [np.zeros(len(begins)) for begins in self.moves]

    def later(self, times: list[np.ndarray]) -> dict[str, np.ndarray]:
        """Return by run how much later (rows,) s each row acts: as its move, which lasts until the next one begins."""
        found = {}
        for run, begins, mine in zip(self.judge.problem.runs, self.moves, times, strict=True):
            at_first = int(begins[0]) - 1 if len(begins) else len(run.time)
            lasting = np.diff(np.r_[begins, len(run.time) + 1])[: len(begins)]
            found[run.name] = np.r_[np.zeros(at_first), np.repeat(mine, lasting)]
        return found

    def residual(self, trial: Trial, times: list[np.ndarray]) -> Residual:
        """Return what ``trial`` leaves with moves at these ``times``."""
        return self._timed(times).residual(trial.hypothesis, trial.fit.point, trial.placed)

    def error(self, trial: Trial, times: list[np.ndarray]) -> float:
        """Return the rms error above the noise, about the mean of each hold; infinite where the body diverges."""
        try:
            found = self.residual(trial, times).runs
        except SolverError:
            return np.inf
        holds = [_still(found[k], hold) for k, run in enumerate(self._holds) for hold in run]
        return float(self.judge.excess(sum(float(np.sum(hold**2)) for hold in holds) / sum(map(len, holds))))

    def towards(self, trial: Trial, times: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the step of Gauss and Newton of the parameters (p,) and of times: these are eliminated first."""
        problem, interval_s = self._timed(times), self.judge.problem.interval_s
        step, certain = DIFFERENCE * interval_s, 12.0 / interval_s**2
        now, moved = self.residual(trial, times), self.residual(trial, [time + step for time in times])
        normal, gradient = np.eye(len(trial.fit.point)) / ALIKE**2, np.zeros(len(trial.fit.point))
        rows = []
        for k, columns in enumerate(slopes(problem, trial, now)):
            noise = max(self.judge.floor, QUIET * self.judge.material) / np.sqrt(now.runs[k].shape[1])
            for hold, time in zip(self._holds[k], times[k], strict=True):
                left, late, free = (
                    _still(x, hold).reshape(-1, *x.shape[2:]) / noise
                    for x in (now.runs[k], (moved.runs[k] - now.runs[k]) / step, columns)
                )
                own, both, wanted = late @ late + certain, free.T @ late, -(late @ left) - time * certain
                normal += free.T @ free - np.outer(both, both) / own
                gradient -= free.T @ left + both * (wanted / own)
                rows.append((own, both, wanted))
        change = np.linalg.solve(normal, gradient)
        steps = np.array([(wanted - both @ change) / own for own, both, wanted in rows])
        return change, np.split(steps, np.cumsum([len(mine) for mine in times])[:-1])

    def moved(
        self, trial: Trial, times: list[np.ndarray], towards: tuple[np.ndarray, list[np.ndarray]], share: float
    ) -> tuple[Trial, list[np.ndarray]]:
        """Return parameters and times after a ``share`` of a step, the parameters within their bounds."""
        low, high = self.judge.problem.space(trial.hypothesis).bounds
        point = np.clip(trial.fit.point + share * towards[0], low, high)
        there = [time + share * step for time, step in zip(times, towards[1], strict=True)]
        return trial._replace(fit=trial.fit._replace(point=point)), there

    def _timed(self, times: list[np.ndarray]) -> Problem:
        return replace(self.judge.problem, later=self.later(times))

    @property
    def _holds(self) -> list[list[slice]]:
        """The bins of every run from each move to the next: a row's command acts from the row before on."""
        found = []
        for bins, first, begins in zip(self.judge.problem.bins, self.judge.problem.first, self.moves, strict=True):
            edges = [int(bins.number[min(max(row - 1 - first, 0), len(bins.number) - 1)]) for row in begins]
            ends = [*edges[1:], len(bins)][: len(edges)]
            found.append([slice(a, max(b, a + 1)) for a, b in zip(edges, ends, strict=True)])
        return found


def _still(values: np.ndarray, hold: slice) -> np.ndarray:
    """Return ``values`` (bins, ...) in a hold less their mean there."""
    return np.asarray(values[hold] - values[hold].mean(axis=0))


def _moves(run: Recording) -> np.ndarray:
    """Return the rows with which moves of the pressures begin."""
    steps = np.abs(np.diff(run.pressure_cmd, axis=0, prepend=run.pressure_cmd[:1])).max(axis=1)
    moving = steps > MOVE * steps.max(initial=0.0)
    return np.flatnonzero(moving & ~np.r_[False, moving[:-1]])
