"""When something began, or in which sessions it acted, where held-out runs alone tell: no fit sees what was not fitted."""

import itertools
import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.choices import alike, may_be_gated
from softrl.diagnosis.fitting.hypothesis import MOMENTS, Choice, Gate, Hypothesis, effect_axes, neutral
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial, axes_of, columns_of
from softrl.diagnosis.judging.leftover import heldout_residual
from softrl.effects.gate import WIDTHS
from softrl.recordings.gone import sessions_in_order
from softrl.recordings.recording import Recording

log = logging.getLogger(__name__)
SLACK_S = 1.0  # by which a fit may miss the edge of what it does not see
COARSE, FINE, ROUNDS = 25, 7, 3  # moments that are tried, then about the best one, ever closer
SUDDEN = 20.0  # times as long and as short as a gate takes to open, and ever closer likewise


@dataclass(frozen=True)
class Dating:
    """What dates a hypothesis: ``fitting``, the problem that it was fitted to, and the ``judge`` on runs that no fit saw."""

    fitting: Problem
    judge: Judge

    def on_heldout(self, trial: Trial) -> Trial:
        """Return the trial with its squared errors on the held-out runs."""
        return trial._replace(squares=heldout_residual(self.judge, trial).squares)

    def that_run(self, trials: Sequence[Trial]) -> list[Trial]:
        """Return the trials with their squared errors on the held-out runs; one that diverges there is left out."""
        found = []
        for trial in trials:
            try:
                found.append(self.on_heldout(trial))
            except SolverError as error:
                log.info("%s diverges on held-out runs and is dropped: %s", trial.hypothesis.label(), error)
        return found

    def of(self, trial: Trial) -> Trial:
        """Return the trial, with its squared errors on the held-out runs, as these favour it among what fits cannot tell apart.

        That is in which of the sessions held out something acts, and at which moment between two fitted runs it began: then it
        may have begun in the middle of a run, and not with a session.
        """
        for choice in trial.hypothesis.effects:
            trial = self._in_sessions(trial, choice)
        for choice in trial.hypothesis.effects:
            trial = self._at_a_moment(trial, choice)
            begun = self._from_a_moment(trial, choice)
            # all that it removes lies in one stretch of time, which most draws of blocks do not hold
            if begun is not None and self.judge.stands_out(trial.squares, begun.squares):
                trial = begun
        return trial

    def _in_sessions(self, trial: Trial, old: Choice) -> Trial:
        training = [run.session for run in self.fitting.runs]
        order = sessions_in_order((*self.fitting.runs, *self.judge.problem.runs))
        forms = [new for new in alike(old, training, order) if new != old]
        tasks = [tuple(new if effect == old else effect for effect in trial.hypothesis.effects) for new in forms]
        others = [trial._replace(hypothesis=Hypothesis(effects, trial.hypothesis.tuned)) for effects in tasks]
        return self._best(trial, others)

    def _at_a_moment(self, trial: Trial, choice: Choice) -> Trial:
        axes = axes_of(trial, choice)
        moment = next((name for name in axes if name in MOMENTS), None)
        if choice.lasting != "ever" or moment is None:
            return trial
        axis, column = axes[moment]
        unseen = between_fits(self.fitting.runs, self.judge.problem.runs, axis.physical(float(trial.fit.point[column])))
        if unseen is None:
            return trial
        low, high = unseen
        moments, step, factor = np.linspace(low, high, COARSE), (high - low) / (COARSE - 1), SUDDEN
        for _ in range(ROUNDS):
            trial = self._best(trial, [_with(trial, column, axis.scaled(float(moment))) for moment in moments])
            trial = self._how_suddenly(trial, choice, unseen, factor)
            best = axis.physical(float(trial.fit.point[column]))
            moments = np.clip(np.linspace(best - step, best + step, FINE), low, high)
            step, factor = step * 2.0 / (FINE - 1), factor ** (2.0 / (FINE - 1))
        return self._seen_beside(trial, low, high)

    def _how_suddenly(self, trial: Trial, choice: Choice, unseen: tuple[float, float], factor: float) -> Trial:
        """Return the trial with the time that its gate takes to open as held-out runs favour it, about the same middle.

        Times up to ``factor`` shorter and longer are tried, but none in which it would open where fits see it.
        """
        axes = axes_of(trial, choice)
        if WIDTHS["since_s"] not in axes:
            return trial
        (since, at), (over, beside) = axes["since_s"], axes[WIDTHS["since_s"]]
        begin, width = since.physical(float(trial.fit.point[at])), over.physical(float(trial.fit.point[beside]))
        others = []
        for other in np.clip(width * np.geomspace(1.0 / factor, factor, FINE), over.low, over.high):
            first = begin + 0.5 * (width - float(other))
            if unseen[0] - SLACK_S <= first and first + other <= unseen[1] + SLACK_S:
                others.append(_with(_with(trial, at, since.scaled(first)), beside, over.scaled(float(other))))
        return self._best(trial, others)

    def _seen_beside(self, trial: Trial, low: float, high: float) -> Trial:
        """Return the trial with its own errors on the runs that end at ``low`` or begin at ``high``.

        Fits that one of these is left out of know even less of when it began, which says nothing against the hypothesis.
        """
        beside = [k for k, run in enumerate(self.fitting.runs) if _span(run)[1] == low or _span(run)[0] == high]
        try:
            seen = self.fitting.residual(trial.hypothesis, trial.fit.point, trial.placed).squares
        except SolverError:  # where held-out runs put it the fitted ones do not run: what fits said of them stays
            return trial
        return trial._replace(inside=np.where(np.isin(self.fitting.run_of_bin, beside), seen, trial.inside))

    def _from_a_moment(self, trial: Trial, choice: Choice) -> Trial | None:
        """Return the trial with what acts from a session on acting from some moment on; None if it does not, or cannot."""
        runs = (*self.fitting.runs, *self.judge.problem.runs)
        if not choice.sessions or choice.lasting or choice.sessions[-1] != sessions_in_order(runs)[-1]:
            return None
        begin = min(_span(run)[0] for run in self.fitting.runs if run.session in choice.sessions)
        form = choice._replace(sessions=(), gate=Gate("since_s", begin), lasting="ever")
        if "since_s" not in may_be_gated(choice) or between_fits(self.fitting.runs, self.judge.problem.runs, begin) is None:
            return None
        effects = tuple(form if effect == choice else effect for effect in trial.hypothesis.effects)
        own = len(effect_axes(choice))
        columns = [int(columns_of(trial, choice)[-1]) + 1] * (len(effect_axes(form)) - own)
        fit = trial.fit._replace(
            point=np.insert(trial.fit.point, columns, neutral(form)[own:]),
            jacobian=np.insert(trial.fit.jacobian, columns, 0.0, axis=1),
        )
        begun = trial._replace(hypothesis=Hypothesis(effects, trial.hypothesis.tuned), fit=fit)
        return self._at_a_moment(begun, form)

    def _best(self, trial: Trial, others: Sequence[Trial]) -> Trial:
        return min((trial, *self.that_run(others)), key=lambda one: one.mean_square)


def redated(before: Trial, after: Trial) -> list[Choice]:
    """Return the effects of ``after`` that took another form than ``before``: they begin at a moment that no fit sees."""
    return [choice for choice in after.hypothesis.effects if choice not in before.hypothesis.effects and choice.gate]


def told_of_dates(before: Trial, after: Trial, named: Sequence[Choice]) -> tuple[str, ...]:
    """Return a sentence for each of the effects ``named`` that held-out runs have dated, out of those ``after`` they did."""
    return tuple(
        f"{new.label()}: when it began, or in which sessions it acted, no fitted run shows; held-out runs date it, and the "
        "error that they are predicted with is the best of those dates."
        for old, new in zip(before.hypothesis.effects, after.hypothesis.effects, strict=True)
        if new in named and (new != old or not np.array_equal(_own(before, old), _own(after, new)))
    )


def _own(trial: Trial, choice: Choice) -> np.ndarray:
    return np.asarray(trial.fit.point[columns_of(trial, choice)])


def between_fits(fitted: Sequence[Recording], heldout: Sequence[Recording], moment_s: float) -> tuple[float, float] | None:
    """Return from when to when about ``moment_s``, on the clock of all runs, no fitted run was recorded but one held out was.

    None where a fitted run shows the moment, or no held-out one could.
    """
    spans = sorted(_span(run) for run in fitted)
    for (_, low), (high, _) in itertools.pairwise(spans):
        shown = any(low < end and start < high for start, end in map(_span, heldout))
        if low - SLACK_S <= moment_s <= high + SLACK_S and shown:
            return low, high
    return None


def _span(run: Recording) -> tuple[float, float]:
    return run.gone_s[-1], run.gone_s[-1] + float(np.ptp(run.time))


def _with(trial: Trial, column: int, u: float) -> Trial:
    """Return the trial with one parameter moved to where fits do not see it, so that they say nothing of its value."""
    point, jacobian = trial.fit.point.copy(), trial.fit.jacobian.copy()
    point[column], jacobian[:, column] = u, 0.0
    return trial._replace(fit=trial.fit._replace(point=point, jacobian=jacobian))
