"""Add, swap and drop effects while that pays on runs left out of the fit."""

import logging
from collections.abc import Callable, Sequence

import numpy as np

from softrl.diagnosis.flexible import pressures
from softrl.diagnosis.hypothesis import Choice, Gate, Hypothesis, effect_axes, gated, may_be_gated, starts
from softrl.diagnosis.judge import SHOWN, Judge
from softrl.diagnosis.path import Path
from softrl.diagnosis.problem import Problem
from softrl.diagnosis.rank import Lead, rank
from softrl.diagnosis.slim import slim
from softrl.diagnosis.trial import Search, Trial, columns_of, drop, fit_trials, join, raced
from softrl.effects.library import effect_class

log = logging.getLogger(__name__)
SAME_NAME = 2  # forms of one effect (all chambers, one chamber) that are fitted in full
LEAD_SHARE = 0.3  # of the best rough fit's gain, which another needs to be fitted in full
LEAD_GAIN = 0.03  # share of the squared error: a rough fit that saves less will not save what counts when fitted in full
PLAIN = 2.5  # times what counts: what is left, before effects are asked where alone they act, if none was found before
SOME = 1.8  # the same where one was found: what it leaves may be that it acts there alone
BESIDE = 0.5  # of what must show: what saves less of the squared error beside an effect does not stand in its place
REFORMED = 2  # fits of a round, the best, in which older effects are tried in their other forms


def forward(
    fitting: Problem,
    judge: Judge,
    tuned: Sequence[str],
    choices: Sequence[Choice],
    search: Search,
    report: Callable[[str], None],
) -> Path:
    """Return the hypothesis that stepwise selection leaves: add, try all others in each one's place, drop, narrow down.

    Parameters
    ----------
    fitting : problem on the training runs
    judge : scores on the same runs, each left out of the fit in turn, and says what pays
    tuned : simulator parameters that are refitted with every hypothesis
    choices : effects to consider
    report : told of each round in a sentence
    """
    retuned = fit_trials(fitting, None, [(Hypothesis((), tuple(tuned)), [])], search)[0]
    path = Path(retuned, retuned)
    _grow(fitting, judge, choices, search, path, report)
    if _narrow(fitting, judge, choices, search, path, report):
        _grow(fitting, judge, choices, search, path, report)
    return path


def _grow(
    fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path, report: Callable[[str], None]
) -> None:
    """Add effects to the best hypothesis of ``path`` while that pays."""
    while len(path.best.hypothesis.effects) < search.max_effects:
        current = path.best
        if judge.excess(current.mean_square) < judge.material:
            report(f"{current.hypothesis.label()}: what is left is less than counts")
            break
        added = _addition(fitting, judge, current, choices, search, path)
        if added is None:
            break
        report(
            f"{current.hypothesis.label()}: rms {judge.rms(current.squares):.4g}, best addition "
            f"{added.hypothesis.effects[-1].label()}: {judge.rms(added.squares):.4g} on runs left out"
        )
        if not _pays(judge, current, added):
            break
        added = slim(fitting, judge, added, search, path)
        path.best = _swap(fitting, judge, added, choices, search, path)
        path.best = _prune(fitting, judge, path.best, search, path)
        path.best = slim(fitting, judge, path.best, search, path)


def _pays(judge: Judge, current: Trial, added: Trial) -> bool:
    """Return whether the effect that ``added`` has beyond ``current`` pays; the first only has to show."""
    decide = judge.pays if current.hypothesis.effects else judge.shows
    return decide(current.squares, added.squares)


def _narrow(
    fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path, report: Callable[[str], None]
) -> bool:
    """Return whether an effect that acts above a pressure or from a time on only pays: one of ``path``, or a new one."""
    before = path.best
    plain = (SOME if before.hypothesis.effects else PLAIN) * judge.material
    if judge.excess(before.mean_square) < plain:
        return False
    forms = _gated([choice for choice in choices if not choice.session], fitting)
    beside = rank(fitting, before, _not_taken(forms, before), search)
    promising = {lead.choice for lead in beside if lead.gain >= BESIDE * _least_share(judge, before)}
    for name in before.hypothesis.names:
        old = path.best.hypothesis.named(name)  # what was put in another's place may have changed its form
        if old is not None and judge.excess(path.best.mean_square) >= plain:
            in_place = [form for form in forms if form.name == old.name or form in promising]
            _replace(fitting, judge, old, in_place, search, path)
    if len(before.hypothesis.effects) < search.max_effects and judge.excess(path.best.mean_square) >= plain:
        added = _addition(fitting, judge, path.best, forms, search, path, beside if path.best is before else None)
        if added is not None and _pays(judge, path.best, added):
            added = slim(fitting, judge, added, search, path)
            path.best = _prune(fitting, judge, _swap(fitting, judge, added, choices, search, path), search, path)
    if path.best is not before:
        report(f"{path.best.hypothesis.label()}: {judge.rms(path.best.squares):.4g} on runs left out")
    return path.best is not before


def _least_share(judge: Judge, trial: Trial) -> float:
    """Return the share of the squared error of ``trial`` that has to go for anything to show, see ``Judge.shows``."""
    noise = judge.thresholds.noise_share**2
    return max((SHOWN * judge.material) ** 2 / trial.mean_square, noise / (1.0 + noise))


def _replace(
    fitting: Problem, judge: Judge, old: Choice, choices: Sequence[Choice], search: Search, path: Path
) -> None:
    """Put the best of ``choices`` in the place of ``old``, one of the effects of the best hypothesis, if it shows."""
    trial = path.best
    if not choices:
        return
    less = path.fit(fitting, [(trial.hypothesis.without(old), drop(trial, old))], search)
    instead = _addition(fitting, judge, less[0], choices, search, path) if less else None
    if instead is not None and judge.shows(trial.squares, instead.squares):
        path.best = slim(fitting, judge, instead, search, path)


def _gated(choices: Sequence[Choice], problem: Problem) -> list[Choice]:
    """Return the forms of ``choices`` that act above a pressure or from a time on only."""
    duration = float(np.median([run.time[-1] - run.time[0] for run in problem.runs]))
    highest = max(float(pressures(problem, k).max()) for k in range(len(problem.runs)))
    return [form for choice in dict.fromkeys(choices) for form in gated(choice, duration, highest)]


def _not_taken(choices: Sequence[Choice], trial: Trial) -> list[Choice]:
    """Return the ``choices`` whose effect ``trial`` does not have yet."""
    return [choice for choice in choices if choice.name not in trial.hypothesis.names]


def _addition(
    fitting: Problem,
    judge: Judge,
    current: Trial,
    choices: Sequence[Choice],
    search: Search,
    path: Path,
    leads: list[Lead] | None = None,
) -> Trial | None:
    """Return ``current`` with the best further effect, if one runs; what was tried is noted in ``path``.

    ``leads`` are what ``rank`` says of the choices, where it was asked before.
    """
    taken = current.hypothesis.names
    leads = rank(fitting, current, _not_taken(choices, current), search) if leads is None else leads
    if not taken or len(path.screened) < len(taken) + 1:
        path.screened.append(leads)
    trials = fit_leads(fitting, current, leads, search)
    if not trials:
        return None
    every = trials + _otherwise(fitting, trials, search, path)
    paying = [trial for trial in every if _pays(judge, current, trial)]  # the simplest of all may be too simple to pay
    best = judge.simplest(paying or every)
    for old, new in zip(current.hypothesis.effects, best.hypothesis.effects[:-1], strict=True):
        if old != new:
            path.tried[new] = path.tried.get(old, [])
    path.tried[best.hypothesis.effects[-1]] = _others(trials, best) + [
        (lead.choice, lead.point[: len(effect_axes(lead.choice))])
        for lead in leads
        if lead.choice not in {t.hypothesis.effects[-1] for t in trials}
    ]
    return best


def _swap(fitting: Problem, judge: Judge, trial: Trial, choices: Sequence[Choice], search: Search, path: Path) -> Trial:
    """Return ``trial`` after each of its older effects was put to the test against all others in its place.

    A map without physics has to pay against them, see ``Judge.simplest``; any other effect stays unless one is better.
    """
    for name in trial.hypothesis.names[:-1]:
        old = trial.hypothesis.named(name)  # what took another's place may have changed its form
        less = path.fit(fitting, [(trial.hypothesis.without(old), drop(trial, old))], search) if old else []
        if old is None or not less:
            continue
        instead = _addition(fitting, judge, less[0], [*choices, *_where(trial, old, choices)], search, path)
        if instead is None:
            continue
        new = instead.hypothesis.effects[-1]
        if new != old and (effect_class(old.name).together or judge.tells(trial.squares, instead.squares)):
            log.info("%s takes the place of %s", new.label(), old.label())
            trial = instead
        elif new != old:
            others = [pair for pair in path.tried.pop(new) if pair[0] != old]
            end = len(instead.fit.point) - len(instead.hypothesis.tuned)
            mine = instead.fit.point[end - len(effect_axes(new)) : end]
            path.tried[old] = [(new, mine), *others]
    return trial


def _where(trial: Trial, old: Choice, choices: Sequence[Choice]) -> list[Choice]:
    """Return the ``choices`` that may act where ``old``, an effect of ``trial``, acts: above its pressure or from its time on.

    What acts everywhere is no rival of what acts there alone, however like it its law may be.
    """
    if old.gate is None:
        return []
    begin = effect_axes(old)[-1].physical(float(trial.fit.point[columns_of(trial, old)[-1]]))
    gate = Gate(old.gate.field, begin)
    others = [c for c in choices if c.name != old.name and c.chamber == old.chamber and not c.session]
    return [old, *(c._replace(gate=gate) for c in others if gate.field in may_be_gated(c))]


def _otherwise(fitting: Problem, trials: Sequence[Trial], search: Search, path: Path) -> list[Trial]:
    """Return the best of ``trials`` with an older effect in another form (all chambers, one chamber) beside the newest.

    Alone the forms may be alike; beside what else is missing only one of them fits.
    """
    tasks = [
        (Hypothesis(tuple(form if e == old else e for e in trial.hypothesis.effects), trial.hypothesis.tuned), [point])
        for trial in sorted(trials, key=lambda t: t.mean_square)[:REFORMED]
        for old in trial.hypothesis.effects[:-1]
        for form, point in _same_name(path, trial, old)
    ]
    best = min(trial.mean_square for trial in trials)
    return raced(fitting, None, tasks, search, best) if tasks else []


def _same_name(path: Path, trial: Trial, old: Choice) -> list[tuple[Choice, np.ndarray]]:
    """Return the other forms of ``old`` that were tried in its place, with a point of ``trial`` to begin at."""
    columns = columns_of(trial, old)
    return [
        (form, np.insert(np.delete(trial.fit.point, columns), columns[0], mine))
        for form, mine in path.tried.get(old, [])
        if form.name == old.name and form != old
    ][:SAME_NAME]


def _others(trials: Sequence[Trial], best: Trial) -> list[tuple[Choice, np.ndarray]]:
    """Return the last effect of every trial but ``best``, with its scaled parameters, best first."""
    found = []
    for trial in sorted(trials, key=lambda t: t.mean_square):
        choice = trial.hypothesis.effects[-1]
        end = len(trial.fit.point) - len(trial.hypothesis.tuned)
        if choice != best.hypothesis.effects[-1]:
            found.append((choice, trial.fit.point[end - len(effect_axes(choice)) : end]))
    return found


def fit_leads(fitting: Problem, current: Trial, leads: Sequence[Lead], search: Search) -> list[Trial]:
    """Return ``current`` with each of the best leads added, fitted in full; at most ``SAME_NAME`` forms of one."""
    tasks: list[tuple[Hypothesis, list[np.ndarray]]] = []
    seen: dict[str, int] = {}
    for lead in leads:
        if len(tasks) == search.keep or lead.gain <= max(LEAD_SHARE * leads[0].gain, LEAD_GAIN):
            break
        seen[lead.choice.name] = seen.get(lead.choice.name, 0) + 1
        if seen[lead.choice.name] <= SAME_NAME:
            tasks.append((current.hypothesis.with_effect(lead.choice), starting_points(current, lead, search.starts)))
    return raced(fitting, None, tasks, search)


def starting_points(current: Trial, lead: Lead, count: int) -> list[np.ndarray]:
    """Return starts of a fit: where the rough fit ended, and with the simulator's parameters at their nominal values.

    Parameters that were retuned in an effect's place lie far off once it acts.
    """
    own, before = len(effect_axes(lead.choice)), len(current.fit.point) - len(current.hypothesis.tuned)
    mine, others = lead.point[:own], lead.point[own:]
    points = [np.concatenate([others[:before], mine, others[before:]])]
    if current.hypothesis.tuned and count > 1:
        fresh = points[0].copy()
        fresh[-len(current.hypothesis.tuned) :] = 0.0
        points.append(fresh)
    if count > 2:
        points += [join(current, start) for start in starts(lead.choice)[: count - 2]]
    return points


def _prune(fitting: Problem, judge: Judge, trial: Trial, search: Search, path: Path) -> Trial:
    """Return ``trial`` without the effects, other than the last, that no longer pay."""
    for choice in trial.hypothesis.effects[:-1]:
        fewer = path.fit(fitting, [(trial.hypothesis.without(choice), drop(trial, choice))], search)
        if fewer and not judge.pays(fewer[0].squares, trial.squares):
            log.info("%s no longer pays and is dropped", choice.label())
            trial = fewer[0]
    return trial
