"""What an effect could save beside a trial, as far as straight lines tell: the first look, before anything is fitted."""

import logging
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm
from scipy.optimize import lsq_linear

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import Choice, effect_axes, neutral
from softrl.diagnosis.fitting.minimise import Fit, jacobian_at
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import FAR, Trial, join
from softrl.effects.library import effect_class

log = logging.getLogger(__name__)
MIN_AMPLITUDE = 0.25  # a search begins at least at this share of an effect's typical size
ROUGH_STARTS = 2  # of every effect that are followed
WILD, GENTLE = 20.0, 0.1  # a size that moves this many times what is left tells no slope: this share of it is tried instead
PLAIN_LOOK = 0.2  # gain along straight lines of the best effect below which they tell little behind a bent curve
IN_VAIN = 0.1  # of the squared error at nominal parameters: where more stays although they went far, the curve is bent
ROUGH_DIFFERENCE = 0.02  # scaled step of differences
RETUNED = 0.1  # likewise: it may have been retuned in an effect's place
MISTAKEN = 0.15  # of what an effect changes: where retuning can do all but this, it may have taken the effect's place
Known = dict[bytes, "Moved | None"]


class Base(NamedTuple):
    """Where rough fits begin: a trial, and an orthonormal basis (rows, p) of what its free parameters can do."""

    trial: Trial
    basis: np.ndarray

    @property
    def left(self) -> np.ndarray:
        """The residual (rows,) that the free parameters cannot remove, to first order."""
        return np.asarray(self.trial.fit.residual - self.basis @ (self.basis.T @ self.trial.fit.residual))


def bases_of(fitting: Problem, current: Trial) -> list[Base]:
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
        Base(trial, np.linalg.qr(trial.fit.jacobian)[0] if trial.fit.jacobian.size else trial.fit.jacobian)
        for trial in trials
    ]


class Moved(NamedTuple):
    """What an effect changes (rows,) beyond what free parameters can do, and the size of all that it changes."""

    beyond: np.ndarray
    size: float

    @property
    def share(self) -> float:
        """Share of it that free parameters cannot do."""
        return float(norm(self.beyond) / self.size)


class Begin(NamedTuple):
    """Where a rough fit may begin: number of the base, scaled parameters, share of the squared error it seems to save.

    ``own`` is the share that it seems to save of what its own base leaves, ``share`` of what the first leaves.
    """

    base: int
    point: np.ndarray
    share: float
    own: float = 0.0


class Look(NamedTuple):
    """The best begins of one effect from every base, the best of all first, and what was simulated for them, by base."""

    begins: list[Begin]
    known: list[Known]

    @property
    def share(self) -> float:
        """The share of the squared error that the effect seems to save; nothing where it does not run."""
        return self.begins[0].share if self.begins else -np.inf


def look_at(
    fitting: Problem, bases: list[Base], choice: Choice, points: list[np.ndarray], closely: bool, known: list[Known]
) -> Look:
    """Return what one effect seems to save; ``known`` is that of a look before, by base."""
    costs = [max(float(np.sum(base.left**2)), 1e-300) for base in bases]
    found = [
        Begin(k, begin, 1.0 - rest / costs[0], 1.0 - rest / costs[k])
        for k, base in enumerate(bases)
        for rest, begin in _begins(fitting, base, choice, points, closely, known[k])[:ROUGH_STARTS]
    ]
    return Look(sorted(found, key=lambda begin: -begin.share), known)


def is_bent(bases: list[Base], reach: float) -> bool:
    """Return whether straight lines, along which ``reach`` is the most that any effect seems to save, tell little."""
    in_vain = any(base.trial.fit.cost > IN_VAIN * bases[-1].trial.fit.cost for base in bases[:-1])
    return reach < PLAIN_LOOK and in_vain


def hidden_by_retuning(base: Base, known: Known) -> bool:
    """Return whether the simulator's parameters, retuned, do nearly all that an effect would: no straight line tells then."""
    free = len(base.trial.hypothesis.tuned)
    retuned = free > 0 and np.abs(base.trial.fit.point[-free:]).max() > RETUNED
    return bool(retuned and any(moved is not None and moved.share < MISTAKEN for moved in known.values()))


@dataclass(frozen=True)
class _Sizes:
    """One effect beside a base, simulated at sizes that are asked for; none twice.

    Attributes
    ----------
    fitting, base, choice : the problem, where it begins, and the effect
    known : what was simulated before
    """

    fitting: Problem
    base: Base
    choice: Choice
    known: Known

    def moved(self, point: np.ndarray) -> Moved | None:
        """Return what the effect changes at ``point``, None where it does nothing or does not run."""
        key = point.tobytes()
        if key not in self.known:
            self.known[key] = self._simulated(point)
        return self.known[key]

    def _simulated(self, point: np.ndarray) -> Moved | None:
        current, basis = self.base.trial, self.base.basis
        hypothesis = current.hypothesis.with_effect(self.choice)
        try:
            moved = self.fitting.residual(hypothesis, join(current, point)).flat - current.fit.residual
        except SolverError:
            return None
        beyond = moved - basis @ (basis.T @ moved)
        return Moved(beyond, float(norm(moved))) if norm(beyond) > 1e-6 * norm(self.base.left) else None

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
    fitting: Problem, base: Base, choice: Choice, points: list[np.ndarray], closely: bool, known: Known
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
    if not effect_class(choice.name).sized:
        moved = [(point, sizes.direction(point)) for point in points]
        return sorted(((left(along), point) for point, along in moved if along is not None), key=lambda pair: pair[0])
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
