"""Add, swap and drop effects while that pays on runs left out of the fit."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.choices import gated
from softrl.diagnosis.fitting.flexible import pressures
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, neutral
from softrl.diagnosis.fitting.judge import SHOWN, Judge
from softrl.diagnosis.fitting.minimise import Fit
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, columns_of, drop, fit_trials, join, raced
from softrl.diagnosis.search.alone import alone
from softrl.diagnosis.search.moves import addition, not_taken, pays, prune, swap
from softrl.diagnosis.search.onset import for_good
from softrl.diagnosis.search.pairs import best_pairs
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.rank import rank
from softrl.diagnosis.search.relieve import relieved
from softrl.diagnosis.search.slim import slim
from softrl.effects.library import effect_class

PLAIN = 2.5  # times what counts: what is left, before effects are asked where alone they act, if none was found before
SOME = 1.8  # the same where one was found: what it leaves may be that it acts there alone
SEVERAL = 8  # times as many pairs are looked at as are fitted: most differ by where the same two act
BESIDE = 0.5  # of what must show: what saves less of the squared error beside an effect does not stand in its place


def forward(
    fitting: Problem,
    judge: Judge,
    tuned: Sequence[str],
    choices: Sequence[Choice],
    search: Search,
    report: Callable[[str], None],
) -> Path:
    """Return the hypothesis that stepwise selection leaves: add, try all others in each one's place, drop, narrow down.

    Two are asked at once where much stays. At last one effect is asked to do for all, and two for a map without physics. After
    many steps, or its minutes, it looks no further.

    Parameters
    ----------
    fitting : problem on the training runs
    judge : scores on the same runs, each left out of the fit in turn, and says what pays
    tuned : simulator parameters that are refitted with every hypothesis
    choices : effects to consider
    report : told of each round in a sentence
    """
    bare = Hypothesis((), tuple(tuned))
    retuned = fit_trials(fitting, None, [(bare, fitting.space(bare).begins)], search)[0]
    path = Path(retuned, retuned, most=search.bounds_of(fitting.simulator)[1], until=search.until)
    _grow(fitting, judge, choices, search, path, report)
    if path.goes_on() and _two_at_once(fitting, judge, choices, search, path, report):
        _grow(fitting, judge, choices, search, path, report)
    for _ in range(search.max_effects):
        better = relieved(fitting, judge, choices, search, path) if path.goes_on() else None
        if better is None:
            break
        path.best = better
        _grow(fitting, judge, choices, search, path, report)
    narrower = path.goes_on() and _narrow(fitting, judge, choices, search, path, report)
    if narrower or (path.goes_on() and _behind_a_map(fitting, judge, choices, search, path, report)):
        _grow(fitting, judge, choices, search, path, report)
    one = alone(fitting, judge, choices, search, path) if path.goes_on() else None
    if one is not None:
        report(f"{one.hypothesis.label()} does as well alone as {path.best.hypothesis.label()}")
        path.best = one
        _grow(fitting, judge, choices, search, path, report)
    if path.goes_on():
        _without_map(fitting, judge, choices, search, path, report)
    if path.cut_short or not search.in_time:
        report(f"{path.best.hypothesis.label()}: the search ends here, after as many steps or minutes as it is allowed")
    return path


def _grow(
    fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path, report: Callable[[str], None]
) -> None:
    """Add effects to the best hypothesis of ``path`` while that pays.

    What is added may drive out what was there, and that be the best addition then: where the search has been it does not go on.
    """
    been: set[frozenset[str]] = set()
    while len(path.best.hypothesis.effects) < search.max_effects:
        current = path.best
        acting = frozenset(choice.label() for choice in current.hypothesis.effects)
        if acting in been:
            report(f"{current.hypothesis.label()}: the search has been here")
            break
        been.add(acting)
        if judge.excess(current.mean_square) < judge.material:
            report(f"{current.hypothesis.label()}: what is left is less than counts")
            break
        if not path.goes_on():
            break
        added = addition(fitting, judge, current, choices, search, path)
        if added is None:
            break
        unit = "Pa" if fitting.target == "pressure" else "m"
        report(
            f"{current.hypothesis.label()}: rms {judge.rms(current.squares):.4g} {unit}, best addition "
            f"{added.hypothesis.effects[-1].label()}: {judge.rms(added.squares):.4g} {unit} on runs left out"
        )
        if not pays(judge, current, added):
            break
        path.best = _settled(fitting, judge, added, choices, search, path)


def _settled(
    fitting: Problem, judge: Judge, added: Trial, choices: Sequence[Choice], search: Search, path: Path
) -> Trial:
    """Return ``added`` slimmed, its effects put to the test, those dropped that no longer pay, and slimmed to what is left.

    Without what was dropped the others may be others: they are put to the test again.
    """
    added = swap(fitting, judge, slim(fitting, judge, added, search, path), choices, search, path)
    fewer = prune(fitting, judge, added, search, path)
    if fewer is not added:
        fewer = swap(fitting, judge, fewer, choices, search, path)
    return slim(fitting, judge, fewer, search, path)


def _narrow(
    fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path, report: Callable[[str], None]
) -> bool:
    """Return whether an effect that acts above a pressure or from a time on only pays: one of ``path``, or a new one."""
    before = path.best
    plain = (SOME if before.hypothesis.effects else PLAIN) * judge.material
    if judge.excess(before.mean_square) < plain:
        return False
    everywhere = [c for c in choices if not (c.sessions or c.lasting)]
    forms = _gated(everywhere, fitting) + for_good(fitting, before, not_taken(everywhere, before), search)
    beside = rank(fitting, before, not_taken(forms, before), search)
    promising = {lead.choice for lead in beside if lead.gain >= BESIDE * _least_share(judge, before)}
    for name in before.hypothesis.names:
        old = path.best.hypothesis.named(name)  # what was put in another's place may have changed its form
        if old is not None and judge.excess(path.best.mean_square) >= plain:
            in_place = [form for form in forms if form.name == old.name or form in promising]
            _replace(fitting, judge, old, in_place, [c for c in everywhere if c.name == old.name], search, path)
    if len(before.hypothesis.effects) < search.max_effects and judge.excess(path.best.mean_square) >= plain:
        added = addition(fitting, judge, path.best, forms, search, path, beside if path.best is before else None)
        if added is not None and pays(judge, path.best, added):
            path.best = _settled(fitting, judge, added, choices, search, path)
    if path.best is not before:
        report(f"{path.best.hypothesis.label()}: {judge.rms(path.best.squares):.4g} on runs left out")
    return path.best is not before


def _behind_a_map(
    fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path, report: Callable[[str], None]
) -> bool:
    """Return whether an effect that acts somewhere alone pays together with a map without which neither explains anything.

    A map that was fitted to runs in which something begins midway is right for neither half of them.
    """
    bare, maps = path.best, [choice for choice in choices if effect_class(choice.name).together]
    if bare.hypothesis.effects or not maps or judge.excess(bare.mean_square) < PLAIN * judge.material:
        return False
    behind = path.fit(fitting, [(bare.hypothesis.with_effect(maps[0]), join(bare, neutral(maps[0])))], search)
    forms = _gated([c for c in choices if not (c.sessions or c.lasting)], fitting)
    added = addition(fitting, judge, behind[0], forms, search, path) if behind else None
    if added is None or not all(judge.pays(less.squares, added.squares) for less in (bare, behind[0])):
        return False
    path.best = _settled(fitting, judge, added, choices, search, path)
    report(f"{path.best.hypothesis.label()}: {judge.rms(path.best.squares):.4g} on runs left out, neither without the other")
    return True


def _without_map(
    fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path, report: Callable[[str], None]
) -> None:
    """Put two effects in the place of a map without physics that explains all there is, where they predict as well.

    A map bends to anything: it is chosen where two things are missing and neither explains much alone. Beside other effects
    it makes up for what these do not get right, and would be taken for two more.
    """
    mapped = path.best
    if len(mapped.hypothesis.effects) != 1 or not effect_class(mapped.hypothesis.names[0]).together or search.max_effects < 2:
        return
    the_map = mapped.hypothesis.effects[0]
    try:
        less = _as_it_was(fitting, mapped, the_map)
    except SolverError:  # the body as it was retuned beside the map does not run without it
        return
    physics = [c for c in not_taken(choices, less) if c != the_map and not c.sessions]
    pairs = best_pairs(fitting.rough_about(less.hypothesis, less.fit.point), less, physics, search)
    trials = raced(fitting, None, [(pair.hypothesis, [pair.point]) for pair in pairs], search, mapped).finished
    best = judge.simplest(trials) if trials else mapped
    report(f"{best.hypothesis.label()} in the place of {the_map.label()}: {judge.rms(best.squares):.4g} on runs left out")
    if best is mapped or judge.pays(best.squares, mapped.squares):
        return
    path.best = _both_settled(fitting, judge, best, physics, search, path)


def _two_at_once(
    fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path, report: Callable[[str], None]
) -> bool:
    """Return whether two effects that were fitted at once leave plainly less than those that were found one after the other.

    What explains most of two alone may be neither of them, and once it is there the others explain little beside it. Asked
    where much stays.
    """
    before = path.best
    if search.max_effects < 2 or judge.excess(before.mean_square) < SOME * judge.material:
        return False
    bare, found = path.retuned, {}
    physics = [choice for choice in not_taken(choices, bare) if not effect_class(choice.name).together]
    many = replace(search, keep=SEVERAL * search.keep)
    for pair in best_pairs(fitting.rough_about(bare.hypothesis, bare.fit.point), bare, physics, many):
        found.setdefault(frozenset(pair.hypothesis.names), (pair.hypothesis, [pair.point]))
    both = raced(fitting, None, list(found.values())[: search.keep], search, before).finished
    more = 2 > len(before.hypothesis.effects)
    better = [t for t in both if (judge.pays if more else judge.tells)(before.squares, t.squares)]
    if not better:
        return False
    best = judge.simplest(better)
    report(f"{best.hypothesis.label()}, both at once: {judge.rms(best.squares):.4g} on runs left out")
    path.best = _both_settled(fitting, judge, best, physics, search, path)
    return True


def _both_settled(
    fitting: Problem, judge: Judge, best: Trial, choices: Sequence[Choice], search: Search, path: Path
) -> Trial:
    """Return ``best``, two effects that were fitted at once, each put to the test against the ``choices``."""
    last = best.hypothesis.effects[-1]
    first = path.fit(fitting, [(best.hypothesis.without(last), drop(best, last))], search)
    added = addition(fitting, judge, first[0], choices, search, path, against=best) if first else None
    settled = _settled(fitting, judge, added, choices, search, path) if added else best
    if judge.tells(settled.squares, best.squares):
        _note_as_tried(path, best, settled)
        settled = best
    return settled


def _note_as_tried(path: Path, best: Trial, other: Trial) -> None:
    """Note what ``other`` has in the place of an effect of ``best`` as tried there."""
    for mine in best.hypothesis.effects:
        for instead in other.hypothesis.effects:
            if instead not in best.hypothesis.effects and mine not in other.hypothesis.effects:
                others = [pair for pair in path.tried.get(instead, []) if pair[0] != mine]
                path.tried[mine] = [(instead, other.fit.point[columns_of(other, instead)]), *others]


def _as_it_was(fitting: Problem, trial: Trial, choice: Choice) -> Trial:
    """Return ``trial`` without one of its effects, all else as it was."""
    hypothesis, point = trial.hypothesis.without(choice), drop(trial, choice)
    value = fitting.residual(hypothesis, point).flat
    jacobian = np.delete(trial.fit.jacobian, columns_of(trial, choice), axis=1)
    return trial._replace(hypothesis=hypothesis, fit=Fit(point, value, jacobian, 0.5 * float(value @ value), 0))


def _least_share(judge: Judge, trial: Trial) -> float:
    """Return the share of the squared error of ``trial`` that has to go for anything to show, see ``Judge.shows``."""
    noise = judge.thresholds.noise_share**2
    return max((SHOWN * judge.material) ** 2 / trial.mean_square, noise / (1.0 + noise))


def _replace(
    fitting: Problem, judge: Judge, old: Choice, choices: Sequence[Choice], own: Sequence[Choice], search: Search, path: Path
) -> None:
    """Put the best of ``choices`` in the place of ``old``, one of the effects of the best hypothesis, if it shows.

    So may its ``own`` forms, as they act everywhere, from some moment on.
    """
    trial = path.best
    less = path.fit(fitting, [(trial.hypothesis.without(old), drop(trial, old))], search)
    forms = [*choices, *for_good(fitting, less[0], own, search)] if less else []
    instead = addition(fitting, judge, less[0], forms, search, path) if forms else None
    if instead is not None and judge.shows(trial.squares, instead.squares):
        path.best = slim(fitting, judge, instead, search, path)


def _gated(choices: Sequence[Choice], problem: Problem) -> list[Choice]:
    """Return the forms of ``choices`` that act above a pressure or from a time on only."""
    duration = float(np.median([run.time[-1] - run.time[0] for run in problem.runs]))
    highest = max(float(pressures(problem, k).max()) for k in range(len(problem.runs)))
    return [form for choice in dict.fromkeys(choices) for form in gated(choice, duration, highest)]
