"""Another effect in the place of one beside which a retuned parameter goes far, or to the end of its range."""

import logging
from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, as_nominal, columns_of, drop, raced
from softrl.diagnosis.search.moves import implausible, not_taken, others_of, pays, prune
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.slim import slim

log = logging.getLogger(__name__)
MOST = 8  # fits that go on to the end: where the effect that is replaced did little, nearly all others do as well
FAR_OFF = float(np.log(2.0))  # a parameter retuned by more than this, in logarithms, is taken for a sign


def relieved(fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path) -> Trial | None:
    """Return what does better than the best hypothesis of ``path`` where a retuned parameter of it is implausible, or far off.

    That is one effect more, where a parameter is implausible and it pays, or another in one's place that does as well with
    plausible parameters, none of them far off; None if there is neither. A mass three times too large is in part the load that
    was left out; rough fits do not come from there to a load, so that each effect is fitted in full here, from nominal
    parameters.
    """
    best = path.best
    odd, effects = implausible(judge, best), best.hypothesis.effects
    if not (odd or (effects and _is_far(judge, best))) or (not effects and judge.excess(best.mean_square) < judge.material):
        return None
    others = [c for c in not_taken(choices, best) if c.chamber < 0 and not (c.sessions or c.lasting)]
    if odd and len(effects) < search.max_effects:
        beside = raced(fitting, None, [_with(best, other) for other in others], search, best, most=MOST).finished
        paying = [trial for trial in beside if pays(judge, best, trial)]
        if paying:
            return _taken(fitting, judge, paying, beside, search, path)
    for old in reversed(effects):
        if not path.goes_on():
            break
        instead = raced(fitting, None, [_with(best, other, old) for other in others], search, best, most=MOST).finished
        near = [t for t in instead if not (implausible(judge, t) or (not odd and _is_far(judge, t)))]
        as_good = [trial for trial in near if not judge.tells(trial.squares, best.squares)]
        if as_good:
            mine = (old, best.fit.point[columns_of(best, old)])
            return _taken(fitting, judge, as_good, instead, search, path, [mine, *path.tried.pop(old, [])])
    return None


def _is_far(judge: Judge, trial: Trial) -> bool:
    """Return whether a parameter of the simulator is another by more than ``FAR_OFF`` beside what ``trial`` has."""
    tuned, nominal = judge.problem.space(trial.hypothesis).tuned(trial.fit.point), judge.problem.simulator.parameters
    return any(abs(np.log(value / nominal[name])) > FAR_OFF for name, value in tuned.items())


def _with(trial: Trial, new: Choice, old: Choice | None = None) -> tuple[Hypothesis, list[np.ndarray]]:
    """Return the hypothesis of ``trial`` with ``new``, in the place of ``old`` if given, and where its fit begins."""
    less = trial.hypothesis.without(old) if old else trial.hypothesis
    point = as_nominal(drop(trial, old) if old else trial.fit.point, less)
    place = len(point) - len(less.tuned)
    return less.with_effect(new), [np.insert(point, place, starts(new)[0])]


def _taken(
    fitting: Problem,
    judge: Judge,
    trials: list[Trial],
    every: list[Trial],
    search: Search,
    path: Path,
    tried: Sequence[tuple[Choice, np.ndarray]] = (),
) -> Trial:
    """Return the simplest of ``trials``, without what no longer pays beside its newest effect or of its numbers.

    That effect's rivals are ``every`` trial's.
    """
    trial = judge.simplest(trials)
    log.info("%s is best where each was fitted from nominal parameters", trial.hypothesis.label())
    path.tried[trial.hypothesis.effects[-1]] = [*tried, *others_of(every, trial)]
    trial = slim(fitting, judge, trial, search, path, len(trial.hypothesis.effects) - 1)
    return prune(fitting, judge, trial, search, path)
