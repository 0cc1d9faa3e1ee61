"""Parts of the pipeline put together again: what was found behind the measured pressure, refitted from the command."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import LATE, Hypothesis
from softrl.diagnosis.fitting.intervals import by_effect, intervals
from softrl.diagnosis.fitting.judge import Thresholds
from softrl.diagnosis.fitting.minimise import least_squares
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, of_effects, shared_out
from softrl.diagnosis.judging.examine import Finding

log = logging.getLogger(__name__)


def put_together(whole: Problem, findings: Sequence[Finding]) -> Problem:
    """Return the problem from command to motion: its log may be late by as much as those of all its parts.

    Where the first part, which begins with the commands, is understood by another clock of theirs, they act by that.
    """
    most, parts = whole.late_max_s, len(findings)
    later = findings[0].part.problem.later
    return replace(whole, late_max_s=parts * most, late_apart_s=(parts - 1) * most, later=later)


def joined(training: Problem, findings: Sequence[Finding], search: Search, thresholds: Thresholds) -> list[Finding]:
    """Return the findings with the last part's parameters refitted from command to motion, the valve's effects held.

    A measured pressure is sampled, noisy and late; as the body's drive it biases what is found behind it, and a log's
    lateness against it is not that against the command. Nothing changes where there is one part only or nothing was
    found, where the refit does not run, or where it would bend the body's physics to make up for what the valve's does
    not get right: where it lets the body err under the pressures that were measured by a larger factor than it helps from
    the command, though as found they serve there, too, or what the command does to the pressure is unknown.
    """
    if len(findings) < 2 or not any(finding.final.hypothesis.effects for finding in findings):
        return list(findings)
    *before, motion = findings
    tuned, start = training.tuned, np.r_[of_effects(motion.final), tuned_together(findings[0].final, motion.final)]
    valve = tuple(choice for finding in before for choice in finding.final.hypothesis.effects)
    hypothesis = Hypothesis((*valve, *motion.final.hypothesis.effects), tuned)
    held = np.concatenate([of_effects(finding.final) for finding in before])
    count = len(held)
    low, high = training.space(hypothesis).bounds

    def residual(free: np.ndarray) -> np.ndarray:
        return training.residual(hypothesis, np.concatenate([held, free])).flat

    try:
        several = shared_out(training, hypothesis, search.workers, held)
        fit = least_squares(residual, start, low[count:], high[count:], search.iterations, several=several)
        together = training.residual(hypothesis, np.concatenate([held, fit.point]))
        apart = training.residual(hypothesis, np.concatenate([held, start])).squares
        plain = training.residual(Hypothesis((), tuned), motion.base.fit.point).squares
        behind = np.r_[fit.point[:-1], motion.final.fit.point[-1]] if LATE in tuned else fit.point
        helped = float(np.sqrt(apart.mean() / together.squares.mean()))
        serves = apart.mean() < plain.mean() or findings[0].unknown
        if serves and _spoilt(motion, behind, helped):
            log.info("behind the valve as it is understood the body's parameters would go astray: they are kept")
            return list(findings)
    except SolverError:
        return list(findings)
    point = np.concatenate([held, fit.point])
    still = np.zeros((len(fit.residual), count))
    whole = fit._replace(point=point, jacobian=np.hstack([still, fit.jacobian]))
    trial = Trial(hypothesis, whole, together.registrations, together.squares, together.squares)
    mine = by_effect(hypothesis, intervals(training, trial, thresholds))
    named = [effect._replace(intervals=mine[effect.choice]) for effect in motion.named]
    return [*before, replace(motion, named=named, joint=point)]


def tuned_together(first: Trial, last: Trial) -> np.ndarray:
    """Return what is tuned besides effects from command to motion, scaled: the body as in the last part, the log as in both.

    How late the motion is against the measured pressures comes on top of how late those are against the command; see
    ``put_together`` for the scale of their sum.
    """
    found = last.fit.point[len(of_effects(last)) :].copy()
    if LATE in first.hypothesis.tuned and first is not last:
        found[-1] = 0.5 * (first.fit.point[-1] + found[-1])
    return np.asarray(found)


def _spoilt(motion: Finding, point: np.ndarray, times: float) -> bool:
    """Return whether at ``point`` (p,) the body errs plainly, and ``times``, more under the measured pressures than as found."""
    found, problem = motion.final, motion.part.problem
    before = motion.judge.rms(problem.residual(found.hypothesis, found.fit.point).squares)
    after = motion.judge.rms(problem.residual(found.hypothesis, point).squares)
    return after > max(times * before, before + motion.judge.material)
