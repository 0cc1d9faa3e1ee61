"""Every effect of the library fitted roughly beside a trial, so that only the promising ones are fitted in full."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm
from scipy.optimize import lsq_linear

from softrl.core.errors import SolverError
from softrl.diagnosis.hypothesis import Choice, effect_axes, neutral, starts
from softrl.diagnosis.problem import Problem
from softrl.diagnosis.search import Fit, jacobian_at, refine
from softrl.diagnosis.trial import Search, Trial, join, parallel, squares_left_out

log = logging.getLogger(__name__)
MIN_AMPLITUDE = 0.25  # a search begins at least at this share of an effect's typical size
ROUGH_STARTS = 2  # of every effect that are followed
WILD, GENTLE = 20.0, 0.1  # a size that moves this many times what is left tells no slope: this share of it is tried instead
LOOK_SHARE = 0.2  # of the best effect's gain, along straight lines, which another needs to be fitted at all
CLOSER = 0.25  # of that: what seems to explain less at the sizes that are tried first is not looked at more closely
PROMISING = 0.3  # of the best gain: what an effect above a pressure saves in all chambers, to be tried in one alone
PLAIN_LOOK = 0.2  # gain along straight lines of the best effect below which they tell little behind a bent curve
IN_VAIN = 0.1  # of the squared error at nominal parameters: where more stays although they went far, the curve is bent
SECOND_LOOK = 0.5  # of an effect's best begin's gain, which another begin of it needs to be followed
ROUGH_DIFFERENCE = 0.02  # scaled step of differences
FAR = 0.5  # a parameter retuned by more than this factor, in logarithms, is no longer near nominal
MISTAKEN, RETUNED = 0.15, 0.1  # share of a motion that parameters retuned by so much, in logarithms, cannot bring about
Known = dict[bytes, "_Moved | None"]


class Lead(NamedTuple):
    """An effect fitted roughly: its scaled parameters with those of the simulator, and the squared error left out.

    ``gain`` is the share of the squared error, of runs left out of the fit, that it saves.
    """

    choice: Choice
    point: np.ndarray
    gain: float


def rank(fitting: Problem, current: Trial, choices: Sequence[Choice], search: Search) -> list[Lead]:
    """Return all ``choices`` fitted roughly beside ``current``, the one that predicts runs left out best first.

    A look along straight lines comes first; what could explain little beside the best is not followed further. All others
    are fitted nonlinearly, first for all chambers, then in each chamber alone from the shapes found so. What acts above a
    pressure only is tried in one chamber where it promises something in all; from a time on any chamber may fail alone.
    """
    seen, fitting = fitting.seen, fitting.rough_about(current.hypothesis, current.fit.point)
    bases = _bases(fitting, current)
    for_all = [choice for choice in choices if choice.chamber < 0]
    leads, reach = _leads(fitting, bases, [(c, starts(c, seen.get(c.name, ()))) for c in for_all], 0.0, search)
    shapes = {_form(lead.choice): lead.point[: len(effect_axes(lead.choice))] for lead in leads}
    least = PROMISING * max((lead.gain for lead in leads), default=0.0)
    promising = {_form(lead.choice) for lead in leads if lead.gain >= max(least, 0.0)}
    anyhow = (None, "since_s")
    alone = [c for c in choices if c.chamber >= 0 and ((c.gate and c.gate.field) in anyhow or _form(c) in promising)]
    tasks = [(c, [_plain(c, shapes.get(_form(c))), starts(c)[0]]) for c in alone]
    leads += _leads(fitting, bases, tasks, reach, search)[0]
    return sorted(leads, key=lambda lead: -lead.gain)


def _form(choice: Choice) -> tuple[str, tuple[str, ...], str]:
    """Return what choices with the same parameters have in common."""
    return choice.name, choice.pinned, choice.gate.field if choice.gate else ""


def _leads(
    fitting: Problem, bases: list["_Base"], tasks: list[tuple[Choice, list[np.ndarray]]], reach: float, search: Search
) -> tuple[list[Lead], float]:
    """Return the leads of ``tasks`` (choice, starting points), and the best look; ``reach`` is the best of others."""
    looks, hidden = _looks(fitting, bases, tasks, reach, search)
    reach = max([reach, *(look[0].share for look in looks if look)])
    bent = _bent(bases, reach)
    followed = [
        bool(look) and (bent or behind or look[0].share >= LOOK_SHARE * reach)
        for look, behind in zip(looks, hidden, strict=True)
    ]
    jobs = [
        (fitting, bases, choice, _begun(look, bent), search.rough_steps)
        for (choice, _), look, kept in zip(tasks, looks, followed, strict=True)
        if kept
    ]
    fitted = iter(parallel(_rough_fit, jobs, search.workers))
    leads = [
        next(fitted) if kept else _left_behind(bases, choice, points, look)
        for (choice, points), look, kept in zip(tasks, looks, followed, strict=True)
    ]
    return leads, reach


def _looks(
    fitting: Problem, bases: list["_Base"], tasks: list[tuple[Choice, list[np.ndarray]]], reach: float, search: Search
) -> tuple[list[list["_Begin"]], list[bool]]:
    """Return the begins of every task, and whether retuning may have taken its place.

    Begins are found at the sizes that are tried first, and where that promises anything closely.
    """
    jobs = [(fitting, bases, choice, points, False, [{} for _ in bases]) for choice, points in tasks]
    looks = parallel(_look, jobs, search.workers)
    reach = max([reach, *(found[0].share for found, _ in looks if found)])
    least = -np.inf if _bent(bases, reach) else CLOSER * LOOK_SHARE * reach
    near = [k for k, (found, _) in enumerate(looks) if found and found[0].share >= least]
    again = parallel(_look, [(*jobs[k][:4], True, looks[k][1]) for k in near], search.workers)
    closely = dict(zip(near, again, strict=True))
    return [closely.get(k, look)[0] for k, look in enumerate(looks)], [_mistaken(bases[0], known[0]) for _, known in looks]


def _mistaken(base: "_Base", known: Known) -> bool:
    """Return whether the simulator's parameters, retuned, do nearly all that an effect would: no straight line tells then."""
    free = len(base.trial.hypothesis.tuned)
    retuned = free > 0 and np.abs(base.trial.fit.point[-free:]).max() > RETUNED
    return bool(retuned and any(moved is not None and moved.share < MISTAKEN for moved in known.values()))


def _bent(bases: list["_Base"], reach: float) -> bool:
    """Return whether straight lines, along which ``reach`` is the most that any effect seems to save, tell little."""
    in_vain = any(base.trial.fit.cost > IN_VAIN * bases[-1].trial.fit.cost for base in bases[:-1])
    return reach < PLAIN_LOOK and in_vain


class _Base(NamedTuple):
    """Where rough fits begin: a trial, and an orthonormal basis (rows, p) of what its free parameters can do."""

    trial: Trial
    basis: np.ndarray

    @property
    def left(self) -> np.ndarray:
        """The residual (rows,) that the free parameters cannot remove, to first order."""
        return np.asarray(self.trial.fit.residual - self.basis @ (self.basis.T @ self.trial.fit.residual))


def _bases(fitting: Problem, current: Trial) -> list[_Base]:
    """Return ``current``, and if the simulator's parameters went far, the same with them back at nominal.

    Parameters that were retuned in an effect's place lead to wherever they hide it best, often to a bound, from where
    a few steps do not come back.
    """
    trials = [current]
    free = len(current.hypothesis.tuned)
    if free and np.abs(current.fit.point[-free:]).max() > FAR:
        point = current.fit.point.copy()
        point[-free:] = 0.0
        low, high = fitting.space(current.hypothesis).bounds
        try:
            value = fitting.residual(current.hypothesis, point).flat
            jacobian = jacobian_at(
                lambda u: fitting.residual(current.hypothesis, u).flat, point, value, low, high, ROUGH_DIFFERENCE
            )
            fit = Fit(point, value, jacobian, 0.5 * float(value @ value), 0)
            trials.append(current._replace(fit=fit))
        except SolverError:
            log.debug("%s does not run with nominal parameters", current.hypothesis.label())
    return [
        _Base(trial, np.linalg.qr(trial.fit.jacobian)[0] if trial.fit.jacobian.size else trial.fit.jacobian)
        for trial in trials
    ]


def _plain(choice: Choice, shape: np.ndarray | None) -> np.ndarray:
    """Return the fitted ``shape`` of an effect, or its typical one where the fit left it nearly neutral."""
    typical, zero = starts(choice)[0], neutral(choice)
    if shape is None or np.abs(shape - zero).max() < MIN_AMPLITUDE * np.abs(typical - zero).max():
        return typical
    return shape


class _Moved(NamedTuple):
    """What an effect changes (rows,) beyond what free parameters can do, and the size of all that it changes."""

    beyond: np.ndarray
    size: float

    @property
    def share(self) -> float:
        """Share of it that free parameters cannot do."""
        return float(norm(self.beyond) / self.size)


class _Begin(NamedTuple):
    """Where a rough fit may begin: number of the base, scaled parameters, share of the squared error it seems to save."""

    base: int
    point: np.ndarray
    share: float


def _look(
    fitting: Problem, bases: list[_Base], choice: Choice, points: list[np.ndarray], closely: bool, known: list[Known]
) -> tuple[list[_Begin], list[Known]]:
    """Return the best begins of one effect from every base, the best of all first, and what was simulated for them.

    ``known`` is that of a look before, by base.
    """
    cost = float(np.sum(bases[0].left ** 2))
    found = [
        _Begin(k, begin, 1.0 - rest / max(cost, 1e-300))
        for k, base in enumerate(bases)
        for rest, begin in _begins(fitting, base, choice, points, closely, known[k])[:ROUGH_STARTS]
    ]
    return sorted(found, key=lambda begin: -begin.share), known


def _begun(look: list[_Begin], bent: bool) -> list[_Begin]:
    """Return the begins that are followed: those that seem good enough, and if ``bent`` the best from every base.

    Behind a strongly bent curve an effect and the stiffness have to change together before anything is gained, which no
    straight line shows.
    """
    best = {begin.base: begin for begin in reversed(look)} if bent else {}
    return [b for b in look if b.share >= SECOND_LOOK * look[0].share or b is best.get(b.base)]


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
    found: list[Fit] = []
    for base, begin, _ in look:
        trial = bases[base].trial
        known = np.insert(trial.fit.jacobian, [first] * len(own), 0.0, axis=1)
        try:
            # what the others do from nominal changes with the effect: their derivatives anew, too
            fresh = np.arange(len(low)) if base > 0 else own
            best = min((fit.cost for fit in found), default=np.inf)
            fit = refine(residual, join(trial, begin), known, fresh, low, high, steps, best=best)
        except SolverError:
            continue
        found.append(fit)
    if not found:
        return Lead(choice, np.r_[look[0].point, current.fit.point], -np.inf)
    fit = min(found, key=lambda one: one.cost)
    left = 2.0 * fit.cost / len(current.squares)
    if left < before:  # runs left out are predicted no better than those that are fitted
        left = float(squares_left_out(fitting, hypothesis, fit, low, high).mean())
    return Lead(choice, np.r_[fit.point[own], np.delete(fit.point, own)], 1.0 - left / max(before, 1e-300))


@dataclass(frozen=True)
class _Sizes:
    """One effect beside a base, simulated at sizes that are asked for; none twice.

    Attributes
    ----------
    fitting, base, choice : the problem, where it begins, and the effect
    known : what was simulated before
    """

    fitting: Problem
    base: _Base
    choice: Choice
    known: Known

    def moved(self, point: np.ndarray) -> _Moved | None:
        """Return what the effect changes at ``point``, None where it does nothing or does not run."""
        key = point.tobytes()
        if key not in self.known:
            self.known[key] = self._simulated(point)
        return self.known[key]

    def _simulated(self, point: np.ndarray) -> _Moved | None:
        current, basis = self.base.trial, self.base.basis
        hypothesis = current.hypothesis.with_effect(self.choice)
        try:
            moved = self.fitting.residual(hypothesis, join(current, point)).flat - current.fit.residual
        except SolverError:
            return None
        beyond = moved - basis @ (basis.T @ moved)
        return _Moved(beyond, float(norm(moved))) if norm(beyond) > 1e-6 * norm(self.base.left) else None

    def direction(self, point: np.ndarray) -> np.ndarray | None:
        """Return what the effect changes beyond what the free parameters can do, (rows,)."""
        moved = self.moved(point)
        return None if moved is None else moved.beyond

    def gently(self, point: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return ``point``, or one nearer to ``start`` where that is far too much, and its direction.

        A mass that makes the body fall over says nothing about a tenth of it.
        """
        moved = self.moved(point)
        if moved is not None and moved.size > WILD * norm(self.base.left):
            nearer = start + GENTLE * (point - start)
            if (along := self.direction(nearer)) is not None:
                return nearer, along
        return point, self.direction(point)


def _begins(
    fitting: Problem, base: _Base, choice: Choice, points: list[np.ndarray], closely: bool, known: Known
) -> list[tuple[float, np.ndarray]]:
    """Return (cost that would be left, starting point) of one effect, best first, as far as straight lines tell.

    The effect is simulated at a few sizes beside ``current``; the differences, less what the free parameters can do,
    are fitted to the residual within the effect's bounds. If ``closely``, it is simulated at the best sizes as well.
    """
    sizes, residual, zero = _Sizes(fitting, base, choice, known), base.left, neutral(choice)
    log_axis = np.array([axis.log for axis in effect_axes(choice)])

    def left(moved: np.ndarray) -> float:
        return float(np.sum((residual + moved) ** 2))

    found: list[tuple[float, np.ndarray]] = []
    for typical in points:
        point, along = sizes.gently(typical, np.where(log_axis, typical, zero))
        if along is not None:
            most = 2.0 if point is typical else 2.0 / GENTLE
            share = float(np.clip(-(along @ residual) / (along @ along), 0.0, most))
            begin = np.where(log_axis, point, zero + max(share, MIN_AMPLITUDE) * (point - zero))
            if not closely:
                found.append((left(share * along), begin))
                continue
            shorter = sizes.direction(begin)
            if shorter is None or left(along) < left(shorter):  # a wall out of reach does nothing
                begin, shorter = point, along
            found.append((min(left(share * along), left(shorter)), begin))
    if not log_axis[0]:
        found += _jointly(sizes, points[0], zero, log_axis)
    return sorted(found, key=lambda pair: pair[0])


def _jointly(
    sizes: _Sizes, typical: np.ndarray, zero: np.ndarray, log_axis: np.ndarray
) -> list[tuple[float, np.ndarray]]:
    """Return what is left by the bounded linear combination of the effect's own parameters, each moved alone, and where.

    Signs come out free.
    """
    columns, places = [], []
    for k in range(len(zero)):
        point = zero.copy()
        point[k] = typical[k] if typical[k] != zero[k] else zero[k] + 1.0
        point, along = sizes.gently(point, zero)
        if along is not None:
            columns.append(along)
            places.append((k, point[k] - zero[k]))
    if not columns:
        return []
    ends = np.array([sorted((a.scaled(a.low), a.scaled(a.high))) for a in effect_axes(sizes.choice)])
    low = np.array([min((ends[k] - zero[k]) / by) for k, by in places])
    high = np.array([max((ends[k] - zero[k]) / by) for k, by in places])
    solved = lsq_linear(np.stack(columns, axis=1), -sizes.base.left, (low - 1e-9, high + 1e-9))
    begin = np.where(log_axis, typical, zero)
    for (k, by), share in zip(places, solved.x, strict=True):
        begin[k] = zero[k] + share * by
    return [(2.0 * float(solved.cost), begin)]
