"""The steps of a search: the best addition, another effect in one's place, one less."""

import logging
from collections.abc import Collection, Hashable, Sequence

import numpy as np

from softrl.diagnosis.fitting.choices import may_be_gated
from softrl.diagnosis.fitting.hypothesis import Choice, Gate, Hypothesis, effect_axes, has_chamber, starts
from softrl.diagnosis.fitting.judge import SHOWN, SHOWN_BESIDE, Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, as_nominal, columns_of, drop, join, raced
from softrl.diagnosis.search.moment import at_its_moment
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.rank import LEAD_GAIN, LEAD_SHARE, Lead, form_of, rank
from softrl.diagnosis.search.slim import slim
from softrl.effects.library import effect_class

log = logging.getLogger(__name__)
SAME_NAME = 2  # forms of one effect (all chambers, one chamber) that are fitted in full
CLOSE = 1.3  # times the best mean square of a round: what came as near is fitted in full in later rounds, too
REFORMED = 2  # fits of a round, the best, in which older effects are tried in their other forms


def pays(judge: Judge, current: Trial, added: Trial) -> bool:
    """Return whether the effect that ``added`` has beyond ``current`` pays.

    The first only has to show, and so does one without which a retuned parameter goes to the end of its range in its place.
    """
    odd, were_odd = implausible(judge, added), implausible(judge, current)
    if not current.hypothesis.effects:
        return judge.shows(current.squares, added.squares, SHOWN_BESIDE if odd else SHOWN)
    relieved = were_odd and not odd and judge.shows(current.squares, added.squares, 1.0)
    return relieved or judge.pays(current.squares, added.squares)


def implausible(judge: Judge, trial: Trial) -> bool:
    """Return whether a retuned parameter of ``trial`` is at the end of its plausible range."""
    return bool(judge.problem.space(trial.hypothesis).at_the_end(trial.fit.point))


def not_taken(choices: Sequence[Choice], trial: Trial) -> list[Choice]:
    """Return the ``choices`` whose effect ``trial`` does not have yet, without those that only retune."""
    return [choice for choice in choices if choice.name not in trial.hypothesis.names and not choice.retunes]


def addition(
    fitting: Problem,
    judge: Judge,
    current: Trial,
    choices: Sequence[Choice],
    search: Search,
    path: Path,
    leads: list[Lead] | None = None,
    against: Trial | None = None,
) -> Trial | None:
    """Return ``current`` with the best further effect, if one runs; what was tried is noted in ``path``.

    ``leads`` are what ``rank`` says of the choices, where it was asked before; ``against`` is a trial that the result has to
    beat.
    """
    taken = current.hypothesis.names
    leads = rank(fitting, current, not_taken(choices, current), search) if leads is None else leads
    if not taken or len(path.screened) < len(taken) + 1:
        path.screened.append(leads)
    trials = fit_leads(fitting, current, leads, search, path.close, against)
    if not trials:
        return None
    least = CLOSE * min(trial.mean_square for trial in trials)
    path.close |= {trial.hypothesis.effects[-1] for trial in trials if trial.mean_square <= least}
    every = trials + _otherwise(fitting, trials, search, path)
    paying = [trial for trial in every if pays(judge, current, trial)]  # the simplest of all may be too simple to pay
    best = judge.simplest(paying or every)
    slimmer = _as_few(fitting, judge, paying, best, search, path)
    best = next((trial for trial in slimmer if judge.takes_over(trial, best)), best)
    best = at_its_moment(fitting, best, search)
    whole = [trial.hypothesis.effects[-1]._replace(pinned=()) for trial in slimmer]
    trials = slimmer + [trial for trial in trials if trial.hypothesis.effects[-1] not in whole]
    for old, new in zip(current.hypothesis.effects, best.hypothesis.effects[:-1], strict=True):
        if old != new:
            path.tried[new] = path.tried.get(old, [])
    path.tried[best.hypothesis.effects[-1]] = others_of(trials, best) + [
        (lead.choice, lead.point[: len(effect_axes(lead.choice))])
        for lead in leads
        if lead.choice not in {*whole, *(t.hypothesis.effects[-1] for t in trials)}
    ]
    return best


def _as_few(
    fitting: Problem, judge: Judge, trials: Sequence[Trial], best: Trial, search: Search, path: Path
) -> list[Trial]:
    """Return, of the ``trials`` that the data cannot tell from ``best`` for all their parameters, the best with those that pay.

    It is left out if these are more than ``best`` has. A camera that was turned needs six numbers, of which data may show two,
    and a mount that tilts has no more than two.
    """
    mine = best.hypothesis.effects[-1]
    freer = [
        trial for trial in trials
        if len(trial.fit.point) > len(best.fit.point) and not judge.tells(trial.squares, best.squares)
        and not judge.tells(best.squares, trial.squares)
        and not effect_class(trial.hypothesis.effects[-1].name).together
        and effect_class(trial.hypothesis.effects[-1].name).extends != mine.name != trial.hypothesis.effects[-1].name
    ]  # fmt: skip
    nearest = sorted(freer, key=lambda trial: trial.mean_square)[:1]
    slimmed = [slim(fitting, judge, trial, search, path, len(trial.hypothesis.effects) - 1) for trial in nearest]
    return [trial for trial in slimmed if len(trial.fit.point) <= len(best.fit.point)]


def swap(
    fitting: Problem,
    judge: Judge,
    trial: Trial,
    choices: Sequence[Choice],
    search: Search,
    path: Path,
    again: bool = True,
) -> Trial:
    """Return ``trial`` after each of its older effects was put to the test against all others in its place.

    A map without physics has to pay against them, see ``Judge.simplest``; any other effect stays unless one is better. Where
    one took another's place the newest, which was chosen beside that other, is put to the test as well, and where that gives way
    the others are once ``again``, which were put to the test beside it.
    """
    began = trial
    for name in trial.hypothesis.names:
        if trial is began and name == trial.hypothesis.names[-1]:
            break
        if not path.goes_on():
            return trial
        old = trial.hypothesis.named(name)  # what took another's place may have changed its form
        less = path.fit(fitting, [(trial.hypothesis.without(old), drop(trial, old))], search) if old else []
        if old is None or not less:
            continue
        log.info("%s is put to the test: does another do as well in its place?", old.label())
        others_too = [*choices, *where_it_acts(trial, old, choices)]
        instead = addition(fitting, judge, less[0], others_too, search, path, against=trial)
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
    if again and len(began.hypothesis.names) > 1 and began.hypothesis.names[-1] not in trial.hypothesis.names:
        return swap(fitting, judge, trial, choices, search, path, again=False)
    return trial


def where_it_acts(trial: Trial, old: Choice, choices: Sequence[Choice]) -> list[Choice]:
    """Return the ``choices`` that may act where ``old``, an effect of ``trial``, acts: above its pressure or from its time on.

    What acts everywhere is no rival of what acts there alone, however like it its law may be; nor is what acts in all chambers
    of what acts in one. A load or a camera that knows no chambers is one of whatever begins at a time.
    """
    if old.gate is None:
        return []
    begin = effect_axes(old)[-1].physical(float(trial.fit.point[columns_of(trial, old)[-1]]))
    gate = Gate(old.gate.field, begin)
    at_a_time = gate.field == "since_s"
    others = [c for c in choices if c.name != old.name and not c.sessions
              and (c.chamber == old.chamber or (at_a_time and not has_chamber(c.name)))]  # fmt: skip
    return [old, *(c._replace(gate=gate, lasting=old.lasting or c.lasting) for c in others if gate.field in may_be_gated(c))]


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
    best = min(trials, key=lambda trial: trial.mean_square)
    return raced(fitting, None, tasks, search, best).finished if tasks else []


def _same_name(path: Path, trial: Trial, old: Choice) -> list[tuple[Choice, np.ndarray]]:
    """Return the other forms of ``old`` that were tried in its place, with a point of ``trial`` to begin at."""
    columns = columns_of(trial, old)
    return [
        (form, np.insert(np.delete(trial.fit.point, columns), columns[0], mine))
        for form, mine in path.tried.get(old, [])
        if form.name == old.name and form != old
    ][:SAME_NAME]


def others_of(trials: Sequence[Trial], best: Trial) -> list[tuple[Choice, np.ndarray]]:
    """Return the last effect of every trial but ``best``, with its scaled parameters, best first."""
    found = []
    for trial in sorted(trials, key=lambda t: t.mean_square):
        choice = trial.hypothesis.effects[-1]
        end = len(trial.fit.point) - len(trial.hypothesis.tuned)
        if choice != best.hypothesis.effects[-1]:
            found.append((choice, trial.fit.point[end - len(effect_axes(choice)) : end]))
    return found


def fit_leads(
    fitting: Problem,
    current: Trial,
    leads: Sequence[Lead],
    search: Search,
    close: Collection[Choice] = (),
    against: Trial | None = None,
) -> list[Trial]:
    """Return ``current`` with each of the best leads added, fitted in full; at most ``SAME_NAME`` forms of one.

    Those that are beaten early, by each other or by ``against``, are fitted roughly.
    """
    tasks = [
        (current.hypothesis.with_effect(forms[0].choice), starting_points(current, forms, search.starts))
        for forms in _contenders(leads, search.keep, close)
    ]
    race = raced(fitting, None, tasks, search, against)
    return [*race.finished, *race.beaten]


def _contenders(leads: Sequence[Lead], keep: int, close: Collection[Choice] = ()) -> list[list[Lead]]:
    """Return the ``keep`` best effects of ``leads``, best first, each with the leads that differ by where its gate began only.

    Beside them are those that came ``close`` to the best before: a rough fit does not show what an effect does where others
    have to move far with it.

    Laws that contain the same one are much alike and take one place together: a delay is no worse for four bounded lags. Of one
    name ``SAME_NAME`` forms are among them. That for all chambers counts as much as the best of them: alone in one
    chamber a fit is nearer to its end after few steps.
    """
    least = max(LEAD_SHARE * leads[0].gain, LEAD_GAIN) if leads else 0.0
    together: dict[str, list[Lead]] = {}
    best: dict[Hashable, float] = {}
    for lead in leads:
        best.setdefault(form_of(lead.choice), lead.gain)
        if lead.gain > least:
            together.setdefault(lead.choice.label(), []).append(lead)

    def promise(group: list[Lead]) -> float:
        return best[form_of(group[0].choice)] if group[0].choice.chamber < 0 else group[0].gain

    taken: list[list[Lead]] = []
    places = 0
    for group in sorted(together.values(), key=promise, reverse=True):
        name = group[0].choice.name
        same = sum(other[0].choice.name == name for other in taken)
        beside = same == 0 and any(_contained_in(other[0].choice.name) == _contained_in(name) for other in taken)
        if same < SAME_NAME and (beside or places < keep):
            taken.append(group)
            places += not beside
    among = {lead.choice for group in taken for lead in group}
    return taken + [[lead] for lead in leads if lead.choice in close and lead.choice not in among and lead.gain > LEAD_GAIN]


def _contained_in(name: str) -> str:
    """Return the first law that an effect's contains, or its own."""
    return (*effect_class(name).contains, name)[0]


def starting_points(current: Trial, forms: Sequence[Lead], count: int) -> list[np.ndarray]:
    """Return starts of a fit: where rough fits ended, and with the simulator's parameters at their nominal values.

    Parameters that were retuned in an effect's place lie far off once it acts. ``forms`` are the leads of one effect.
    """
    own, before = len(effect_axes(forms[0].choice)), len(current.fit.point) - len(current.hypothesis.tuned)
    ends = [np.r_[lead.point[own:][:before], lead.point[:own], lead.point[own:][before:]] for lead in forms]
    points = ends[:1]
    if current.hypothesis.tuned and count > 1:
        points.append(as_nominal(points[0], current.hypothesis))
    if count > 2:
        points += [join(current, start) for start in starts(forms[0].choice)[: count - 2]]
    return points + ends[1:]


def prune(fitting: Problem, judge: Judge, trial: Trial, search: Search, path: Path) -> Trial:
    """Return ``trial`` without the effects, other than the last, that no longer pay."""
    for choice in trial.hypothesis.effects[:-1]:
        fewer = path.fit(fitting, [(trial.hypothesis.without(choice), drop(trial, choice))], search)
        if fewer and not pays(judge, fewer[0], trial):
            log.info("%s no longer pays and is dropped", choice.label())
            trial = fewer[0]
    return trial
