"""Every effect of the library fitted roughly beside a trial, so that only the promising ones are fitted in full."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.effort import parallel
from softrl.diagnosis.fitting.hypothesis import Choice, effect_axes, neutral, starts
from softrl.diagnosis.fitting.minimise import NEAR, Fit, comes_to, refine
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, join, squares_left_out
from softrl.diagnosis.search.look import (
    MIN_AMPLITUDE,
    Base,
    Begin,
    Look,
    bases_of,
    hidden_by_retuning,
    is_bent,
    look_at,
)
from softrl.diagnosis.search.onset import onsets
from softrl.diagnosis.search.periods import likely
from softrl.effects.library import effect_class

LOOK_SHARE = 0.2  # of the best effect's gain, along straight lines, which another needs to be fitted at all
CLOSER = 0.25  # of that: what seems to explain less at the sizes that are tried first is not looked at more closely
PROMISING = 0.3  # of the best gain: what an effect above a pressure saves in all chambers, to be tried in one alone
SECOND_LOOK = 0.5  # of an effect's best begin's gain, which another begin of it needs to be followed
MOST_OF_IT = 0.5  # of what nominal parameters leave: an effect that seems to save as much beside them is followed from there
FAR_BEHIND = 2.0  # times the cost of the best rough fit: another is not improved further
LEAD_SHARE = 0.3  # of the best rough fit's gain, which another needs to be fitted in full
LEAD_GAIN = 0.03  # share of the squared error: a rough fit that saves less will not save what counts when fitted in full
COMING_DOWN = 0.1  # of the cost where a rough fit began: it is improved however far behind, because it has not come to rest
HOPE = 0.3  # of what a lead needs: a rough fit that neither gains nor promised as much by its first steps is not improved


class Lead(NamedTuple):
    """An effect fitted roughly: its scaled parameters with those of the simulator, and the squared error left out.

    ``gain`` is the share of the squared error, of runs left out of the fit, that it saves.
    """

    choice: Choice
    point: np.ndarray
    gain: float


class Best(NamedTuple):
    """The best of several effects: the share of the squared error of its look, and the cost of its first rough steps."""

    share: float
    cost: float


class Leads(NamedTuple):
    """Leads of some choices, and the best of them."""

    leads: list[Lead]
    best: Best


def rank(fitting: Problem, current: Trial, choices: Sequence[Choice], search: Search) -> list[Lead]:
    """Return all ``choices`` fitted roughly beside ``current``, the one that predicts runs left out best first.

    A look along straight lines comes first; what could explain little beside the best is not followed further. All others
    are fitted nonlinearly, first for all chambers, then in each chamber alone from the shapes found so. What acts above a
    pressure only is tried in one chamber where it promises something in all; from a time on any chamber may fail alone.
    """
    seen, fitting = fitting.seen, fitting.rough_about(current.hypothesis, current.fit.point)
    bases = bases_of(fitting, current)
    choices = likely(fitting, bases[0], choices)
    for_all = [choice for choice in choices if choice.chamber < 0]
    begun = onsets(fitting, bases, for_all, search)
    tasks = [(c, starts(c, [*seen.get((c.name, c.lasting), ()), *begun.get(c, ())])) for c in for_all]
    all_over = _leads(fitting, bases, tasks, Best(0.0, np.inf), search, set(seen))
    leads = all_over.leads
    shapes = {form_of(lead.choice): lead.point[: len(effect_axes(lead.choice))] for lead in leads}
    least = PROMISING * max((lead.gain for lead in leads), default=0.0)
    promising = {form_of(lead.choice) for lead in leads if lead.gain >= max(least, 0.0)}
    anyhow = (None, "since_s")
    alone = [c for c in choices if c.chamber >= 0 and ((c.gate and c.gate.field) in anyhow or form_of(c) in promising)]
    begun = onsets(fitting, bases, alone, search)
    tasks = [(c, [_plain(c, shapes.get(form_of(c))), *_begins_alone(c, begun.get(c, ()))]) for c in alone]
    leads = leads + _leads(fitting, bases, tasks, all_over.best, search).leads
    return sorted(leads, key=lambda lead: -lead.gain)


def _begins_alone(choice: Choice, begun: Sequence[dict[str, float]]) -> list[np.ndarray]:
    """Return where one chamber's fit begins beside the shape of all: where it seems to have ``begun``, for one."""
    return starts(choice, begun) if choice.lasting or begun else starts(choice)[:1]


def form_of(choice: Choice) -> tuple[str, tuple[str, ...], str, str, tuple[str, ...]]:
    """Return what choices with the same parameters have in common."""
    return choice.name, choice.pinned, choice.gate.field if choice.gate else "", choice.lasting, choice.sessions


def _leads(
    fitting: Problem,
    bases: list[Base],
    tasks: list[tuple[Choice, list[np.ndarray]]],
    best: Best,
    search: Search,
    seen: Collection[tuple[str, str]] = (),
) -> Leads:
    """Return the leads of ``tasks`` (choice, starting points), and the best of all; ``best`` is that of others.

    What is ``seen`` in the recordings themselves and has no size is followed whatever straight lines tell. First steps are made
    for all that are followed; what is far behind the best by then is not improved further.
    """
    looks = _looks(fitting, bases, tasks, best.share, search)
    reach = max([best.share, *(look.share for look in looks)])
    bent = is_bent(bases, reach)
    followed = [
        bool(look.begins)
        and (
            bent
            or ((choice.name, choice.lasting) in seen and not effect_class(choice.name).sized)
            or look.share >= LOOK_SHARE * reach
            or hidden_by_retuning(bases[0], look.known[0])
        )
        for (choice, _), look in zip(tasks, looks, strict=True)
    ]
    jobs = [
        (fitting, bases, choice, _begun(look, bent), search.rough_steps)
        for (choice, _), look, kept in zip(tasks, looks, followed, strict=True)
        if kept
    ]
    begun = parallel(_first_steps, [(*job[:3], job[3][0], job[4]) for job in jobs], search.workers)
    cost = min([best.cost, *(fit.cost for fit in begun if fit)])
    target, limit = (np.inf, np.inf) if bent else (cost, _limit(bases[0].trial, cost))
    followed_jobs = [(*job, fit, target, limit) for job, fit in zip(jobs, begun, strict=True)]
    fitted = iter(parallel(_rough_fit, followed_jobs, search.workers))
    leads = [
        next(fitted) if kept else _left_behind(bases, choice, points, look)
        for (choice, points), look, kept in zip(tasks, looks, followed, strict=True)
    ]
    return Leads(leads, Best(reach, cost))


def _limit(current: Trial, best: float) -> float:
    """Return the cost above which a rough fit is not improved, ``best`` being the least of all after their first steps."""
    gain = max(LEAD_SHARE * (1.0 - best / max(current.fit.cost, 1e-300)), LEAD_GAIN)
    return min(FAR_BEHIND * best, (1.0 - HOPE * gain) * current.fit.cost)


def _looks(
    fitting: Problem, bases: list[Base], tasks: list[tuple[Choice, list[np.ndarray]]], reach: float, search: Search
) -> list[Look]:
    """Return a look at every task at the sizes that are tried first, and where that promises anything a closer one."""
    jobs = [(fitting, bases, choice, points, False, [{} for _ in bases]) for choice, points in tasks]
    looks = parallel(look_at, jobs, search.workers)
    reach = max([reach, *(look.share for look in looks)])
    least = -np.inf if is_bent(bases, reach) else CLOSER * LOOK_SHARE * reach
    near = [k for k, look in enumerate(looks) if look.begins and look.share >= least]
    again = parallel(look_at, [(*jobs[k][:4], True, looks[k].known) for k in near], search.workers)
    closely = dict(zip(near, again, strict=True))
    return [closely.get(k, look) for k, look in enumerate(looks)]


def _plain(choice: Choice, shape: np.ndarray | None) -> np.ndarray:
    """Return the fitted ``shape`` of an effect, or its typical one where the fit left it nearly neutral."""
    typical, zero = starts(choice)[0], neutral(choice)
    if shape is None or np.abs(shape - zero).max() < MIN_AMPLITUDE * np.abs(typical - zero).max():
        return typical
    return shape


def _begun(look: Look, bent: bool) -> list[Begin]:
    """Return the begins that are followed: those that seem good enough, and the best from a base that they do much for.

    Behind a strongly bent curve, ``bent``, an effect and the stiffness have to change together before anything is gained,
    which no straight line shows: the best from every base is followed there. One that does away with most of what nominal
    parameters leave may yet be what they were retuned for.
    """
    best = {begin.base: begin for begin in reversed(look.begins)}
    least = min(SECOND_LOOK * look.share, look.share)  # the best itself, if none promises anything
    return [b for b in look.begins if b.share >= least or (b is best[b.base] and (bent or b.own >= MOST_OF_IT))]


def _left_behind(bases: list[Base], choice: Choice, points: list[np.ndarray], look: Look) -> Lead:
    """Return an effect that is not followed, with what it seems to save."""
    begin = look.begins[0] if look.begins else Begin(0, points[0], -np.inf)
    return Lead(choice, np.r_[begin.point, bases[begin.base].trial.fit.point], begin.share)


def _first_steps(fitting: Problem, bases: list[Base], choice: Choice, begin: Begin, steps: int) -> Fit | None:
    """Return where a few steps lead from where an effect was seen: its own derivatives anew, others kept; None if nowhere."""
    trial, own = bases[begin.base].trial, _own(bases, choice)
    known = np.insert(trial.fit.jacobian, [own[0]] * len(own), 0.0, axis=1)
    point = join(trial, begin.point)
    return _stepped(fitting, bases, choice, begin, Fit(point, trial.fit.residual, known, trial.fit.cost, 0), steps)


def _stepped(
    fitting: Problem, bases: list[Base], choice: Choice, begin: Begin, last: Fit, steps: int
) -> Fit | None:
    """Return where a few steps lead from the point of ``last``, whose derivatives by the others are kept; None if nowhere."""
    hypothesis = bases[0].trial.hypothesis.with_effect(choice)
    low, high = fitting.space(hypothesis).bounds
    # what the others do from nominal changes with the effect: their derivatives anew, too
    fresh = np.arange(len(low)) if begin.base > 0 else _own(bases, choice)

    def residual(point: np.ndarray) -> np.ndarray:
        return fitting.residual(hypothesis, point).flat

    try:
        return refine(residual, last.point, last.jacobian, fresh, low, high, steps, last.damping)
    except SolverError:
        return None


def _own(bases: list[Base], choice: Choice) -> np.ndarray:
    """Return the columns of one more effect beside the first base."""
    current = bases[0].trial
    first = len(current.fit.point) - len(current.hypothesis.tuned)
    return np.arange(first, first + len(effect_axes(choice)))


def _rough_fit(
    fitting: Problem,
    bases: list[Base],
    choice: Choice,
    begins: list[Begin],
    steps: int,
    begun: Fit | None,
    best: float,
    limit: float,
) -> Lead:
    """Return one effect, fitted in few steps; ``begun`` is where the first lead from the best begin.

    What costs more than the ``limit`` by then, and never promised less, stays there, unless it did not move at all: where a
    derivative is flat nothing is told. Else the derivatives are found once more where the first steps led, and the other begins
    are followed, unless they come to the same place. ``best`` is the least cost of any effect after its first steps.
    """
    current, own = bases[0].trial, _own(bases, choice)
    found: list[Fit] = [begun] if begun else []
    promised = 0.5 * (1.0 - begins[0].share) * float(np.sum(bases[0].left ** 2))
    stuck = begun is not None and np.abs(begun.point[own] - begins[0].point).max() < NEAR
    if begun is None or stuck or min(begun.cost, promised) <= limit:
        for begin in begins:
            fit = begun if begin is begins[0] else _first_steps(fitting, bases, choice, begin, steps)
            least = min(found, key=lambda one: one.cost, default=None)
            if fit is None or (fit is not begun and comes_to(least, fit.point, fit.cost)):
                continue
            found.append(fit)
            moved = np.abs(fit.point - join(bases[begin.base].trial, begin.point)).max(initial=0.0) >= NEAR
            near = least is None or fit.cost <= FAR_BEHIND * least.cost
            if moved and (near or fit.cost <= COMING_DOWN * bases[begin.base].trial.fit.cost):
                again = _stepped(fitting, bases, choice, begin, fit, steps)
                found += [again] if again else []
    if not found:
        return Lead(choice, np.r_[begins[0].point, current.fit.point], -np.inf)
    fit = min(found, key=lambda one: one.cost)
    return Lead(choice, np.r_[fit.point[own], np.delete(fit.point, own)], _gain(fitting, current, choice, fit, best))


def _gain(fitting: Problem, current: Trial, choice: Choice, fit: Fit, best: float) -> float:
    """Return the share of the squared error, of runs left out, that a rough fit saves.

    Runs left out are predicted no better than those that are fitted: what gains too little there to be fitted in full
    beside the ``best`` is not refitted without them.
    """
    before, bins = current.mean_square, len(current.squares)
    inside, most = (1.0 - 2.0 * cost / bins / max(before, 1e-300) for cost in (fit.cost, min(best, fit.cost)))
    if inside <= 0.0:
        return inside
    hypothesis = current.hypothesis.with_effect(choice)
    squares = squares_left_out(fitting, hypothesis, fit, *fitting.space(hypothesis).bounds, inside >= LEAD_SHARE * most)
    return 1.0 - float(squares.mean()) / before
