"""Fit every effect of the library, and add, swap and drop effects while that pays on runs left out of the fit."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import joblib
import numpy as np
from scipy.optimize import lsq_linear

from softrl.core.errors import ConfigError, SolverError
from softrl.diagnosis.hypothesis import Choice, Hypothesis, effect_axes, may_be_pinned, neutral, starts
from softrl.diagnosis.judge import Judge
from softrl.diagnosis.problem import Problem, Registration
from softrl.diagnosis.search import Fit, jacobian_at, least_squares, refine
from softrl.diagnosis.statistics import left_out

log = logging.getLogger(__name__)
MIN_AMPLITUDE = 0.25  # a search begins at least at this share of an effect's typical size
FIRST_ITERATIONS = 8  # of every start, with longer steps
BEATEN = 9.0  # times the best squared error, after ``FIRST_ITERATIONS``: such a fit is not followed further
SAME_NAME = 2  # forms of one effect (all chambers, one chamber) that are fitted in full
ROUGH_STARTS = 2  # of every effect that are followed
LOOK_SHARE = 0.2  # of the best effect's gain, along straight lines, which another needs to be fitted at all
LEAD_SHARE = 0.3  # of the best rough fit's gain, which another needs to be fitted in full
SECOND_LOOK = 0.5  # of an effect's best begin's gain, which another begin of it needs to be followed
ROUGH_DIFFERENCE = 0.02  # scaled step of differences
FAR = 0.5  # a parameter retuned by more than this factor, in logarithms, is no longer near nominal
SILENT = 1e-6  # of the largest column: a parameter with less influence on the residual has none


@dataclass(frozen=True)
class Search:
    """How hard to look.

    Attributes
    ----------
    max_effects : effects named together at most, for each stage of the pipeline
    keep : effects fitted in full in each round, after all were fitted roughly
    starts : starting points of each fit
    iterations : Jacobians of each full fit at most
    rough_steps : steps of each rough fit at most
    rivals : alternatives to each named effect that are judged on the held-out runs
    fit_s : seconds of motion that fits see at most; runs are cut at a common length
    fit_lumped_s : the same for the lumped body, which is simulated much faster
    workers : processes
    """

    max_effects: int
    keep: int
    starts: int
    iterations: int
    rough_steps: int
    rivals: int
    fit_s: float
    fit_lumped_s: float
    workers: int

    def __post_init__(self) -> None:
        for name in ("keep", "starts", "iterations", "rough_steps", "fit_s", "fit_lumped_s", "workers"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.search.{name}={getattr(self, name):g} must be positive")
        if not 0 <= self.max_effects <= 3:
            raise ConfigError(f"stage.search.max_effects={self.max_effects}; expected 0 to 3")


class Trial(NamedTuple):
    """A fitted hypothesis: its search, the placements found with it, and squared errors (bins,).

    ``inside`` holds those on the fitted runs, each left out in turn; ``squares`` those that judge it: the same, or the
    errors on runs that no fit saw.
    """

    hypothesis: Hypothesis
    fit: Fit
    placed: dict[str, Registration]
    squares: np.ndarray
    inside: np.ndarray

    @property
    def mean_square(self) -> float:
        """Mean squared error on runs left out."""
        return float(self.squares.mean())

    @property
    def everywhere(self) -> np.ndarray:
        """Squared errors on all runs, none of which its fit saw."""
        return np.concatenate([self.inside, self.squares])


class Lead(NamedTuple):
    """An effect fitted roughly: its scaled parameters with those of the simulator, and the squared error left out.

    ``gain`` is the share of the squared error, of runs left out of the fit, that it saves.
    """

    choice: Choice
    point: np.ndarray
    gain: float


@dataclass
class Path:
    """What a search found.

    Attributes
    ----------
    best : the hypothesis that pays
    retuned : the one without effects
    screened : the leads of every round
    tried : for each named effect the alternatives fitted in its place, best first, with their points
    """

    best: Trial
    retuned: Trial
    screened: list[list[Lead]] = field(default_factory=list)
    tried: dict[Choice, list[tuple[Choice, np.ndarray]]] = field(default_factory=dict)


def forward(
    fitting: Problem,
    judge: Judge,
    tuned: Sequence[str],
    choices: Sequence[Choice],
    search: Search,
    report: Callable[[str], None],
) -> Path:
    """Return the hypothesis that stepwise selection leaves: add, try all others in each one's place, drop.

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
    for _ in range(search.max_effects):
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
        if not judge.pays(current.squares, added.squares):
            break
        added = slim(fitting, judge, added, search, path)
        path.best = _swap(fitting, judge, added, choices, search, path)
        path.best = _prune(fitting, judge, path.best, search)
        path.best = slim(fitting, judge, path.best, search, path)
    return path


def _addition(
    fitting: Problem, judge: Judge, current: Trial, choices: Sequence[Choice], search: Search, path: Path
) -> Trial | None:
    """Return ``current`` with the best further effect, if one runs; what was tried is noted in ``path``."""
    taken = {effect.name for effect in current.hypothesis.effects}
    leads = rank(fitting, current, [c for c in choices if c.name not in taken], search)
    if not taken or len(path.screened) < len(taken) + 1:
        path.screened.append(leads)
    trials = fit_leads(fitting, current, leads, search)
    if not trials:
        return None
    best = judge.simplest(trials)
    path.tried[best.hypothesis.effects[-1]] = _others(trials, best) + [
        (lead.choice, lead.point[: len(effect_axes(lead.choice))])
        for lead in leads
        if lead.choice not in {t.hypothesis.effects[-1] for t in trials}
    ]
    return best


def _swap(fitting: Problem, judge: Judge, trial: Trial, choices: Sequence[Choice], search: Search, path: Path) -> Trial:
    """Return ``trial`` after each of its older effects was put to the test against all others in its place."""
    for old in trial.hypothesis.effects[:-1]:
        less = fit_trials(fitting, None, [(trial.hypothesis.without(old), [drop(trial, old)])], search)
        if not less:
            continue
        instead = _addition(fitting, judge, less[0], choices, search, path)
        if instead is None:
            continue
        new = instead.hypothesis.effects[-1]
        if new != old and judge.tells(trial.squares, instead.squares):
            log.info("%s takes the place of %s", new.label(), old.label())
            trial = instead
        elif new != old:
            others = [pair for pair in path.tried.pop(new) if pair[0] != old]
            end = len(instead.fit.point) - len(instead.hypothesis.tuned)
            mine = instead.fit.point[end - len(effect_axes(new)) : end]
            path.tried[old] = [(new, mine), *others]
    return trial


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
        if len(tasks) == search.keep or lead.gain <= max(LEAD_SHARE * leads[0].gain, 0.0):
            break
        seen[lead.choice.name] = seen.get(lead.choice.name, 0) + 1
        if seen[lead.choice.name] <= SAME_NAME:
            tasks.append((current.hypothesis.with_effect(lead.choice), starting_points(current, lead, search.starts)))
    return raced(fitting, None, tasks, search)


def raced(
    fitting: Problem,
    unseen: Problem | None,
    tasks: Sequence[tuple[Hypothesis, list[np.ndarray]]],
    search: Search,
    best: float = np.inf,
) -> list[Trial]:
    """Return the fitted hypotheses, in order; those that are beaten after a few iterations are not fitted to the end.

    ``best`` is the mean squared error, on runs left out, of a trial that they have to compete with.
    """
    first = replace(search, iterations=FIRST_ITERATIONS)
    heat = {trial.hypothesis: trial for trial in fit_trials(fitting.rough, unseen, tasks, first)}
    best = min([best, *(float(trial.inside.mean()) for trial in heat.values())])
    going = [(h, [t.fit.point]) for h, t in heat.items() if t.inside.mean() <= BEATEN * best]
    finished = {trial.hypothesis: trial for trial in fit_trials(fitting, unseen, going, search)}
    return list((heat | finished).values())


def fit_trials(
    fitting: Problem,
    unseen: Problem | None,
    tasks: Sequence[tuple[Hypothesis, list[np.ndarray]]],
    search: Search,
) -> list[Trial]:
    """Return the fitted hypotheses, in order; one that diverges from every start is left out.

    Squared errors are those on ``unseen`` runs, or without any on the fitted runs, each left out in turn.
    """
    jobs = [(fitting, unseen, hypothesis, points, search.iterations) for hypothesis, points in tasks]
    return [trial for trial in parallel(_fit_trial, jobs, search.workers) if trial is not None]


def _fit_trial(
    fitting: Problem, unseen: Problem | None, hypothesis: Hypothesis, points: list[np.ndarray], iterations: int
) -> Trial | None:
    low, high = fitting.space(hypothesis).bounds
    found = []
    for start in points or [np.zeros(len(low))]:
        try:
            found.append(least_squares(lambda u: fitting.residual(hypothesis, u).flat, start, low, high, iterations))
        except SolverError as error:
            log.debug("%s does not run from its start: %s", hypothesis.label(), error)
    if not found:
        return None
    fit = min(found, key=lambda one: one.cost)
    try:
        placed = fitting.residual(hypothesis, fit.point).registrations
        squares = inside = _squares_left_out(fitting, fit, low, high)
        if unseen is not None:
            squares = unseen.residual(hypothesis, fit.point, placed).squares
    except SolverError as error:
        log.info("%s diverges on runs left out and is dropped: %s", hypothesis.label(), error)
        return None
    return Trial(hypothesis, fit, placed, squares, inside)


def _squares_left_out(fitting: Problem, fit: Fit, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return squared errors (bins,) of every run as predicted by a fit to the others."""
    folds, bins = fitting.folds, len(fitting.run_of_bin)
    rows = len(fit.residual) // bins
    error = left_out(fit.jacobian, fit.residual, np.repeat(folds, rows), low - fit.point, high - fit.point)
    return np.asarray(np.sum(error.reshape(bins, rows) ** 2, axis=1))


def rank(fitting: Problem, current: Trial, choices: Sequence[Choice], search: Search) -> list[Lead]:
    """Return all ``choices`` fitted roughly beside ``current``, the one that predicts runs left out best first.

    A look along straight lines comes first; what could explain little beside the best is not followed further. All others
    are fitted nonlinearly, first for all chambers, then in each chamber alone from the shapes found so.
    """
    fitting = fitting.rough
    bases = _bases(fitting, current, search.rough_steps)
    for_all = [choice for choice in choices if choice.chamber < 0]
    leads, reach = _leads(fitting, bases, [(c, starts(c)) for c in for_all], 0.0, search)
    shapes = {lead.choice.name: lead.point[: len(effect_axes(lead.choice))] for lead in leads}
    alone = [choice for choice in choices if choice.chamber >= 0]
    tasks = [(c, [_plain(c, shapes.get(c.name)), starts(c)[0]]) for c in alone]
    leads += _leads(fitting, bases, tasks, reach, search)[0]
    return sorted(leads, key=lambda lead: -lead.gain)


def _leads(
    fitting: Problem, bases: list["_Base"], tasks: list[tuple[Choice, list[np.ndarray]]], reach: float, search: Search
) -> tuple[list[Lead], float]:
    """Return the leads of ``tasks`` (choice, starting points), and the best look; ``reach`` is the best of others."""
    looks = parallel(_look, [(fitting, bases, choice, points) for choice, points in tasks], search.workers)
    reach = max([reach, *(look[0].share for look in looks if look)])
    followed = [bool(look) and look[0].share >= LOOK_SHARE * reach for look in looks]
    jobs = [
        (fitting, bases, choice, look, search.rough_steps)
        for (choice, _), look, kept in zip(tasks, looks, followed, strict=True)
        if kept
    ]
    fitted = iter(parallel(_rough_fit, jobs, search.workers))
    leads = [
        next(fitted) if kept else _left_behind(bases, choice, points, look)
        for (choice, points), look, kept in zip(tasks, looks, followed, strict=True)
    ]
    return leads, reach


class _Base(NamedTuple):
    """Where rough fits begin: a trial, and an orthonormal basis (rows, p) of what its free parameters can do."""

    trial: Trial
    basis: np.ndarray

    @property
    def left(self) -> np.ndarray:
        """The residual (rows,) that the free parameters cannot remove, to first order."""
        return np.asarray(self.trial.fit.residual - self.basis @ (self.basis.T @ self.trial.fit.residual))


def _bases(fitting: Problem, current: Trial, steps: int) -> list[_Base]:
    """Return ``current``, and if the simulator's parameters went far, the same with them back at nominal.

    Parameters that were retuned in an effect's place lead to wherever they hide it best, often to a bound, from where
    a few steps do not come back.
    """
    trials = [_settled(fitting, current, steps)]
    free = len(current.hypothesis.tuned)
    if free and np.abs(trials[0].fit.point[-free:]).max() > FAR:
        point = trials[0].fit.point.copy()
        point[-free:] = 0.0
        low, high = fitting.space(current.hypothesis).bounds
        try:
            value = fitting.residual(current.hypothesis, point).flat
            jacobian = jacobian_at(
                lambda u: fitting.residual(current.hypothesis, u).flat, point, value, low, high, ROUGH_DIFFERENCE
            )
            fit = Fit(point, value, jacobian, 0.5 * float(value @ value), 0)
            trials.append(trials[0]._replace(fit=fit))
        except SolverError:
            log.debug("%s does not run with nominal parameters", current.hypothesis.label())
    return [
        _Base(trial, np.linalg.qr(trial.fit.jacobian)[0] if trial.fit.jacobian.size else trial.fit.jacobian)
        for trial in trials
    ]


def _settled(fitting: Problem, trial: Trial, steps: int) -> Trial:
    """Return ``trial`` refitted roughly on a problem of other steps."""
    low, high = fitting.space(trial.hypothesis).bounds
    none = np.zeros(0, dtype=int)
    fit = refine(
        lambda u: fitting.residual(trial.hypothesis, u).flat,
        trial.fit.point,
        trial.fit.jacobian,
        none,
        low,
        high,
        steps,
    )
    return trial._replace(fit=fit, squares=_squares_left_out(fitting, fit, low, high))


def _plain(choice: Choice, shape: np.ndarray | None) -> np.ndarray:
    """Return the fitted ``shape`` of an effect, or its typical one where the fit left it nearly neutral."""
    typical, zero = starts(choice)[0], neutral(choice)
    if shape is None or np.abs(shape - zero).max() < MIN_AMPLITUDE * np.abs(typical - zero).max():
        return typical
    return shape


class _Begin(NamedTuple):
    """Where a rough fit may begin: number of the base, scaled parameters, share of the squared error it seems to save."""

    base: int
    point: np.ndarray
    share: float


def _look(fitting: Problem, bases: list[_Base], choice: Choice, points: list[np.ndarray]) -> list[_Begin]:
    """Return the best begins of one effect from every base, the best of all first."""
    cost = float(np.sum(bases[0].left ** 2))
    found = [
        _Begin(k, begin, 1.0 - rest / max(cost, 1e-300))
        for k, base in enumerate(bases)
        for rest, begin in _begins(fitting, base, choice, points)[:ROUGH_STARTS]
    ]
    return sorted(found, key=lambda begin: -begin.share)


def _left_behind(bases: list[_Base], choice: Choice, points: list[np.ndarray], look: list[_Begin]) -> Lead:
    """Return an effect that is not followed, with what it seems to save."""
    begin = look[0] if look else _Begin(0, points[0], -np.inf)
    return Lead(choice, np.r_[begin.point, bases[begin.base].trial.fit.point], begin.share)


def _rough_fit(fitting: Problem, bases: list[_Base], choice: Choice, look: list[_Begin], steps: int) -> Lead:
    """Return one effect, fitted in few steps from where it was seen: its own derivatives anew, others kept."""
    current = bases[0].trial
    hypothesis = current.hypothesis.with_effect(choice)
    low, high = fitting.space(hypothesis).bounds
    before = current.mean_square

    def residual(u: np.ndarray) -> np.ndarray:
        return fitting.residual(hypothesis, u).flat

    first = len(current.fit.point) - len(current.hypothesis.tuned)
    own = np.arange(first, first + len(effect_axes(choice)))
    found = []
    for base, begin, share in look:
        if share < SECOND_LOOK * look[0].share:
            continue
        trial = bases[base].trial
        known = np.insert(trial.fit.jacobian, [first] * len(own), 0.0, axis=1)
        try:
            fit = refine(residual, join(trial, begin), known, own, low, high, steps)
        except SolverError:
            continue
        left = float(_squares_left_out(fitting, fit, low, high).mean())
        found.append((left, np.r_[fit.point[own], np.delete(fit.point, own)]))
    if not found:
        return Lead(choice, np.r_[look[0].point, current.fit.point], -np.inf)
    left, point = min(found, key=lambda pair: pair[0])
    return Lead(choice, point, 1.0 - left / max(before, 1e-300))


def _begins(fitting: Problem, base: _Base, choice: Choice, points: list[np.ndarray]) -> list[tuple[float, np.ndarray]]:
    """Return (cost that would be left, starting point) of one effect, best first, as far as straight lines tell.

    The effect is simulated at a few sizes beside ``current``; the differences, less what the free parameters can do,
    are fitted to the residual within the effect's bounds.
    """
    current, basis, residual = base.trial, base.basis, base.left
    hypothesis, zero = current.hypothesis.with_effect(choice), neutral(choice)
    cost = float(residual @ residual)
    log_axis = np.array([axis.log for axis in effect_axes(choice)])

    def direction(point: np.ndarray) -> np.ndarray | None:
        try:
            moved = fitting.residual(hypothesis, join(current, point)).flat - current.fit.residual
        except SolverError:
            return None
        moved = moved - basis @ (basis.T @ moved)
        return moved if moved @ moved > 1e-12 * cost else None

    def left(moved: np.ndarray) -> float:
        return float(np.sum((residual + moved) ** 2))

    found: list[tuple[float, np.ndarray]] = []
    for point in points:
        along = direction(point)
        if along is not None:
            share = float(np.clip(-(along @ residual) / (along @ along), 0.0, 2.0))
            begin = np.where(log_axis, point, zero + max(share, MIN_AMPLITUDE) * (point - zero))
            shorter = direction(begin)
            if shorter is None or left(along) < left(shorter):  # a wall out of reach does nothing
                begin, shorter = point, along
            found.append((min(left(share * along), left(shorter)), begin))
    if not log_axis[0]:
        found += _jointly(direction, points[0], zero, log_axis, residual, choice)
    return sorted(found, key=lambda pair: pair[0])


def _jointly(
    direction: Callable[[np.ndarray], np.ndarray | None],
    typical: np.ndarray,
    zero: np.ndarray,
    log_axis: np.ndarray,
    residual: np.ndarray,
    choice: Choice,
) -> list[tuple[float, np.ndarray]]:
    """Return what is left by the bounded linear combination of the effect's own parameters, each moved alone, and where.

    Signs come out free.
    """
    columns, places = [], []
    for k in range(len(zero)):
        point = zero.copy()
        point[k] = typical[k] if typical[k] != zero[k] else zero[k] + 1.0
        along = direction(point)
        if along is not None:
            columns.append(along)
            places.append((k, point[k] - zero[k]))
    if not columns:
        return []
    ends = np.array([sorted((a.scaled(a.low), a.scaled(a.high))) for a in effect_axes(choice)])
    low = np.array([min((ends[k] - zero[k]) / by) for k, by in places])
    high = np.array([max((ends[k] - zero[k]) / by) for k, by in places])
    solved = lsq_linear(np.stack(columns, axis=1), -residual, (low - 1e-9, high + 1e-9))
    begin = np.where(log_axis, typical, zero)
    for (k, by), share in zip(places, solved.x, strict=True):
        begin[k] = zero[k] + share * by
    return [(2.0 * float(solved.cost), begin)]


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


def join(current: Trial, point: np.ndarray) -> np.ndarray:
    """Return the point of ``current`` with the scaled parameters of one more effect put after its effects'."""
    count = len(current.fit.point) - len(current.hypothesis.tuned)
    return np.concatenate([current.fit.point[:count], point, current.fit.point[count:]])


def drop(trial: Trial, choice: Choice) -> np.ndarray:
    """Return the point of ``trial`` without the parameters of one of its effects."""
    return np.delete(trial.fit.point, _columns(trial, choice))


def _columns(trial: Trial, choice: Choice) -> np.ndarray:
    """Return the places of one effect's parameters in the point of ``trial``."""
    first = 0
    for effect in trial.hypothesis.effects:
        size = len(effect_axes(effect))
        if effect == choice:
            return np.arange(first, first + size)
        first += size
    raise ValueError(f"{choice.label()} is not part of {trial.hypothesis.label()}")


def _prune(fitting: Problem, judge: Judge, trial: Trial, search: Search) -> Trial:
    """Return ``trial`` without the effects, other than the last, that no longer pay."""
    for choice in trial.hypothesis.effects[:-1]:
        tasks = [(trial.hypothesis.without(choice), [drop(trial, choice)])]
        fewer = fit_trials(fitting, None, tasks, search)
        if fewer and not judge.pays(fewer[0].squares, trial.squares):
            log.info("%s no longer pays and is dropped", choice.label())
            trial = fewer[0]
    return trial


def slim(fitting: Problem, judge: Judge, trial: Trial, search: Search, path: Path) -> Trial:
    """Return ``trial`` without the parameters that do not pay: each is pinned at its neutral value and the rest refitted."""
    again = True
    while again:
        again = False
        for choice in trial.hypothesis.effects:
            forms = [_pinned(trial, choice, name) for name in may_be_pinned(choice)]
            forms = [form for form in forms if effect_axes(form[0].effects[form[2]])]
            fitted = fit_trials(fitting, None, [(hypothesis, [point]) for hypothesis, point, _ in forms], search)
            as_good = [t for t in fitted if not judge.tells(t.squares, trial.squares)]
            if as_good:
                slimmer = min(as_good, key=lambda t: t.mean_square)
                place = trial.hypothesis.effects.index(choice)
                path.tried[slimmer.hypothesis.effects[place]] = path.tried.pop(choice, [])
                trial, again = _without_silent(fitting, slimmer, search, path), True
                break
    return trial


def _pinned(trial: Trial, choice: Choice, name: str) -> tuple[Hypothesis, np.ndarray, int]:
    """Return (hypothesis, point, place of the effect) with one more parameter of ``choice`` held at neutral."""
    place = trial.hypothesis.effects.index(choice)
    less = choice._replace(pinned=(*choice.pinned, name))
    effects = tuple(less if effect == choice else effect for effect in trial.hypothesis.effects)
    column = _columns(trial, choice)[[axis.name for axis in effect_axes(choice)].index(name)]
    return Hypothesis(effects, trial.hypothesis.tuned), np.delete(trial.fit.point, column), place


def _without_silent(fitting: Problem, trial: Trial, search: Search, path: Path) -> Trial:
    """Return ``trial`` with the parameters of its effects pinned that have no influence any more."""
    size = np.linalg.norm(trial.fit.jacobian, axis=0)
    for choice in trial.hypothesis.effects:
        columns = _columns(trial, choice)
        for column, axis in zip(columns, effect_axes(choice), strict=True):
            if size[column] <= SILENT * size.max() and len(columns) > 1:
                hypothesis, point, place = _pinned(trial, choice, axis.name)
                path.tried[hypothesis.effects[place]] = path.tried.pop(choice, [])
                fitted = fit_trials(fitting, None, [(hypothesis, [point])], search)
                return _without_silent(fitting, fitted[0], search, path) if fitted else trial
    return trial


def parallel(task: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int) -> list[Any]:
    """Return ``task(*job)`` of every job, in order, in ``workers`` processes."""
    if workers == 1 or len(jobs) < 2:
        return [task(*job) for job in jobs]
    return list(joblib.Parallel(n_jobs=workers, inner_max_num_threads=1)(joblib.delayed(task)(*job) for job in jobs))
