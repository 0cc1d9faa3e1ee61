"""Screen every effect cheaply, fit the promising ones, and add them one by one while it pays on unseen runs."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import joblib
import numpy as np
from scipy.optimize import lsq_linear

from softrl.core.errors import ConfigError, SolverError
from softrl.diagnosis.hypothesis import Choice, Hypothesis, effect_axes, neutral, starts
from softrl.diagnosis.judge import Judge
from softrl.diagnosis.problem import Problem, Registration
from softrl.diagnosis.search import Fit, least_squares

log = logging.getLogger(__name__)
MIN_AMPLITUDE = 0.25  # a search begins at least at this share of an effect's typical size
CLOSER = 8  # effects that are also screened in each chamber alone
HOPELESS = 0.05  # leads that promise less than this share of the best one's gain are not fitted
FIRST_ITERATIONS = 4  # of every start; only the best of them goes on
SAME_NAME = 2  # leads of one effect (all chambers, one chamber) that are fitted


@dataclass(frozen=True)
class Search:
    """How hard to look.

    Attributes
    ----------
    max_effects : effects named together at most, for each stage of the pipeline
    keep : effects fitted in full in each round, after the screening of all
    starts : starting points of each fit
    iterations : Jacobians of each fit at most
    rivals : alternatives to each named effect that are judged on the held-out runs
    fit_s : seconds of motion that fits see at most, and validation 70 % of it; runs are cut at a common length
    fit_lumped_s : the same for the lumped body, which is simulated much faster
    workers : processes
    """

    max_effects: int
    keep: int
    starts: int
    iterations: int
    rivals: int
    fit_s: float
    fit_lumped_s: float
    workers: int

    def __post_init__(self) -> None:
        for name in ("keep", "starts", "iterations", "fit_s", "fit_lumped_s", "workers"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.search.{name}={getattr(self, name):g} must be positive")
        if not 0 <= self.max_effects <= 3:
            raise ConfigError(f"stage.search.max_effects={self.max_effects}; expected 0 to 3")


class Trial(NamedTuple):
    """A fitted hypothesis: its search, the placements found with it, and squared errors (bins,) on validation runs."""

    hypothesis: Hypothesis
    fit: Fit
    placed: dict[str, Registration]
    squares: np.ndarray

    @property
    def mean_square(self) -> float:
        """Mean squared error on the validation runs."""
        return float(self.squares.mean())


class Lead(NamedTuple):
    """A screened effect: starting points (p,) in scaled units, best first, and the share of the cost it may save."""

    choice: Choice
    starts: list[np.ndarray]
    gain: float


class Path(NamedTuple):
    """What a search found.

    ``best`` is the hypothesis that pays, ``retuned`` the one without effects; ``screened`` holds the leads of every
    round, and ``tried`` what was fitted in the round that added an effect, each with its scaled parameters.
    """

    best: Trial
    retuned: Trial
    screened: list[list[Lead]]
    tried: dict[Choice, list[tuple[Choice, np.ndarray]]]


def forward(
    fitting: Problem,
    judge: Judge,
    tuned: Sequence[str],
    choices: Sequence[Choice],
    search: Search,
    report: Callable[[str], None],
) -> Path:
    """Return the hypothesis that forward selection with backward elimination leaves.

    Parameters
    ----------
    fitting : problem on the runs that fits see
    judge : scores on runs that fits do not see, and says what pays
    tuned : simulator parameters that are refitted with every hypothesis
    choices : effects to consider
    report : told of each round in a sentence
    """
    retuned = fit_trials(fitting, judge.problem, [(Hypothesis((), tuple(tuned)), [])], search)[0]
    current, screened = retuned, []
    tried: dict[Choice, list[tuple[Choice, np.ndarray]]] = {}
    for _ in range(search.max_effects):
        if judge.excess(current.mean_square) < judge.material:
            report(f"{current.hypothesis.label()}: what is left is less than counts")
            break
        left = [c for c in choices if c.name not in {e.name for e in current.hypothesis.effects}]
        leads = screen(fitting, current, left, search.workers)
        screened.append(leads)
        trials = fit_leads(fitting, judge.problem, current, leads[: 4 * search.keep], search)
        if not trials:
            break
        best = judge.simplest(trials)
        report(
            f"{current.hypothesis.label()}: rms {judge.rms(current.squares):.4g}, best addition "
            f"{best.hypothesis.effects[-1].label()}: {judge.rms(best.squares):.4g} on validation runs"
        )
        if not judge.pays(current.squares, best.squares):
            break
        tried[best.hypothesis.effects[-1]] = _others(trials, best)
        current = _prune(fitting, judge, best, search)
    return Path(current, retuned, screened, tried)


def _others(trials: Sequence[Trial], best: Trial) -> list[tuple[Choice, np.ndarray]]:
    """Return the last effect of every trial but ``best``, with its scaled parameters, best first."""
    found = []
    for trial in sorted(trials, key=lambda t: t.mean_square):
        choice = trial.hypothesis.effects[-1]
        end = len(trial.fit.point) - len(trial.hypothesis.tuned)
        if choice != best.hypothesis.effects[-1]:
            found.append((choice, trial.fit.point[end - len(effect_axes(choice)) : end]))
    return found


def fit_leads(
    fitting: Problem, validation: Problem, current: Trial, leads: Sequence[Lead], search: Search
) -> list[Trial]:
    """Return ``current`` with each of the best leads added, fitted; at most ``SAME_NAME`` leads of one effect."""
    tasks: list[tuple[Hypothesis, list[np.ndarray]]] = []
    seen: dict[str, int] = {}
    for lead in leads:
        if len(tasks) == search.keep or lead.gain < HOPELESS * leads[0].gain:
            break
        seen[lead.choice.name] = seen.get(lead.choice.name, 0) + 1
        if seen[lead.choice.name] <= SAME_NAME:
            points = starting_points(current, lead, search.starts)
            tasks.append((current.hypothesis.with_effect(lead.choice), points))
    return fit_trials(fitting, validation, tasks, search)


def fit_trials(
    fitting: Problem,
    validation: Problem,
    tasks: Sequence[tuple[Hypothesis, list[np.ndarray]]],
    search: Search,
) -> list[Trial]:
    """Return the fitted hypotheses, in order; one that diverges from every start is left out."""
    jobs = [(fitting, validation, hypothesis, points, search.iterations) for hypothesis, points in tasks]
    return [trial for trial in parallel(_fit_trial, jobs, search.workers) if trial is not None]


def _fit_trial(
    fitting: Problem, validation: Problem, hypothesis: Hypothesis, points: list[np.ndarray], iterations: int
) -> Trial | None:
    low, high = fitting.space(hypothesis).bounds
    rough = []
    for start in points or [np.zeros(len(low))]:
        first = iterations if len(points) < 2 else FIRST_ITERATIONS
        try:
            rough.append(least_squares(lambda u: fitting.residual(hypothesis, u).flat, start, low, high, first))
        except SolverError as error:
            log.debug("%s does not run from its start: %s", hypothesis.label(), error)
    if not rough:
        return None
    fit = min(rough, key=lambda found: found.cost)
    if len(points) > 1 and iterations > FIRST_ITERATIONS:
        rest = iterations - FIRST_ITERATIONS
        fit = least_squares(lambda u: fitting.residual(hypothesis, u).flat, fit.point, low, high, rest)
    try:
        placed = fitting.residual(hypothesis, fit.point).registrations
        squares = validation.residual(hypothesis, fit.point, placed).squares
    except SolverError as error:
        log.info("%s diverges on validation runs and is dropped: %s", hypothesis.label(), error)
        return None
    return Trial(hypothesis, fit, placed, squares)


def screen(fitting: Problem, current: Trial, choices: Sequence[Choice], workers: int) -> list[Lead]:
    """Return all ``choices``, most promising first, by how much of the residual their directions explain linearly.

    Each effect is simulated at a few sizes beside ``current``; the differences, together with the free parameters'
    Jacobian, are fitted to the residual within the effect's bounds.
    """
    jacobian = current.fit.jacobian
    basis = np.linalg.qr(jacobian)[0] if jacobian.size else np.zeros((len(jacobian), 0))
    for_all = [choice for choice in choices if choice.chamber < 0]
    leads = parallel(_screen_one, [(fitting, current, basis, choice) for choice in for_all], workers)
    leads.sort(key=lambda lead: -lead.gain)
    closer = {lead.choice.name for lead in leads[:CLOSER]}
    alone = [choice for choice in choices if choice.chamber >= 0 and choice.name in closer]
    leads += parallel(_screen_one, [(fitting, current, basis, choice) for choice in alone], workers)
    return sorted(leads, key=lambda lead: -lead.gain)


def _screen_one(fitting: Problem, current: Trial, basis: np.ndarray, choice: Choice) -> Lead:
    hypothesis, zero = current.hypothesis.with_effect(choice), neutral(choice)
    residual = current.fit.residual - basis @ (basis.T @ current.fit.residual)
    cost = float(residual @ residual)
    log_axis = np.array([axis.log for axis in effect_axes(choice)])

    def direction(point: np.ndarray) -> np.ndarray | None:
        try:
            moved = fitting.residual(hypothesis, join(current, point)).flat - current.fit.residual
        except SolverError:
            return None
        moved = moved - basis @ (basis.T @ moved)
        return moved if moved @ moved > 1e-12 * cost else None

    found: list[tuple[float, np.ndarray]] = []
    points = starts(choice)
    for point in points:
        along = direction(point)
        if along is not None:
            share = float(np.clip(-(along @ residual) / (along @ along), 0.0, 2.0))
            gain = cost - float(np.sum((residual + share * along) ** 2))
            begin = np.where(log_axis, point, zero + max(share, MIN_AMPLITUDE) * (point - zero))
            found.append((gain, begin))
    if len(zero) > 1 or not log_axis[0]:
        found += _jointly(direction, points[0], zero, log_axis, residual, cost, choice)
    if not found:
        return Lead(choice, [points[0]], 0.0)
    found.sort(key=lambda pair: -pair[0])
    return Lead(choice, [begin for _, begin in found], found[0][0] / max(cost, 1e-300))


def _jointly(
    direction: Callable[[np.ndarray], np.ndarray | None],
    typical: np.ndarray,
    zero: np.ndarray,
    log_axis: np.ndarray,
    residual: np.ndarray,
    cost: float,
    choice: Choice,
) -> list[tuple[float, np.ndarray]]:
    """Return the bounded linear combination of the effect's own parameters, each moved alone: signs come out free."""
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
    return [(cost - 2.0 * float(solved.cost), begin)]


def starting_points(current: Trial, lead: Lead, count: int) -> list[np.ndarray]:
    """Return starts of a fit: beside ``current``, and with the simulator's parameters back at their nominal values.

    Parameters that were retuned in an effect's place lie far off once it acts.
    """
    points = [join(current, lead.starts[0])]
    if current.hypothesis.tuned and count > 1:
        fresh = points[0].copy()
        fresh[-len(current.hypothesis.tuned) :] = 0.0
        points.append(fresh)
    points += [join(current, start) for start in lead.starts[1:]]
    return points[:count]


def join(current: Trial, point: np.ndarray) -> np.ndarray:
    """Return the point of ``current`` with the scaled parameters of one more effect put after its effects'."""
    count = len(current.fit.point) - len(current.hypothesis.tuned)
    return np.concatenate([current.fit.point[:count], point, current.fit.point[count:]])


def drop(trial: Trial, choice: Choice) -> np.ndarray:
    """Return the point of ``trial`` without the parameters of one of its effects."""
    first = 0
    for effect in trial.hypothesis.effects:
        size = len(effect_axes(effect))
        if effect == choice:
            return np.delete(trial.fit.point, slice(first, first + size))
        first += size
    raise ValueError(f"{choice.label()} is not part of {trial.hypothesis.label()}")


def _prune(fitting: Problem, judge: Judge, trial: Trial, search: Search) -> Trial:
    """Return ``trial`` without the effects, other than the last, that no longer pay."""
    for choice in trial.hypothesis.effects[:-1]:
        tasks = [(trial.hypothesis.without(choice), [drop(trial, choice)])]
        fewer = fit_trials(fitting, judge.problem, tasks, search)
        if fewer and not judge.pays(fewer[0].squares, trial.squares):
            log.info("%s no longer pays and is dropped", choice.label())
            trial = fewer[0]
    return trial


def parallel(task: Callable[..., Any], jobs: Sequence[tuple[Any, ...]], workers: int) -> list[Any]:
    """Return ``task(*job)`` of every job, in order, in ``workers`` processes."""
    if workers == 1 or len(jobs) < 2:
        return [task(*job) for job in jobs]
    return list(joblib.Parallel(n_jobs=workers, inner_max_num_threads=1)(joblib.delayed(task)(*job) for job in jobs))
