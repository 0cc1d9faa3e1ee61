"""A hypothesis fitted to the training runs and scored on each of them left out in turn."""

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from softrl.core.errors import ConfigError, SolverError
from softrl.core.simulator import Simulator
from softrl.diagnosis.fitting.effort import parallel
from softrl.diagnosis.fitting.hypothesis import Axis, Choice, Hypothesis, effect_axes
from softrl.diagnosis.fitting.minimise import Fit, Several, least_squares, moved_on
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.series.least_squares import left_out
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.placement import Registration

log = logging.getLogger(__name__)
FIRST_ITERATIONS = 8  # of every start, with longer steps
BEATEN = 9.0  # times the best squared error, after ``FIRST_ITERATIONS``: such a fit is not followed further
PLAINLY = 2.0  # the same for a fit that has settled, beside the best simulated with the same steps
ALIKE = 10.0  # bins that tell as much as one
FAR = 0.5  # a parameter retuned by more than this factor, in logarithms, is no longer near nominal
SEARCHED = 0.6  # of a search's minutes; what it has begun by then, judging and the report take the others
FAR_SHARE = 0.1  # of the squared error: a run that adds more to it once it is left out, along a straight line, is refitted


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
    steps : of the body, after which a search looks no further
    steps_lumped : the same for the lumped body
    rivals : alternatives to each named effect that are judged on the held-out runs
    fit_s : seconds of motion that fits see at most; runs are cut at a common length
    fit_lumped_s : the same for the lumped body, which is simulated much faster
    workers : processes
    minutes : in which a diagnosis is told, or soon after, of what was found until then; None for as many as it takes
    until : ``time.monotonic()`` after which nothing further is asked, see ``begun``
    """

    max_effects: int
    keep: int
    starts: int
    iterations: int
    rough_steps: int
    steps: float
    steps_lumped: float
    rivals: int
    fit_s: float
    fit_lumped_s: float
    workers: int
    minutes: float | None = None
    until: float = np.inf

    def __post_init__(self) -> None:
        for name in ("keep", "starts", "iterations", "rough_steps", "steps", "steps_lumped", "fit_s", "fit_lumped_s", "workers"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.search.{name}={getattr(self, name):g} must be positive")
        if not 0 <= self.max_effects <= 3:
            raise ConfigError(f"stage.search.max_effects={self.max_effects}; expected 0 to 3")
        if self.minutes is not None and self.minutes <= 0.0:
            raise ConfigError(f"stage.search.minutes={self.minutes:g} must be positive, or null for no end")

    def begun(self) -> "Search":
        """Return the search whose minutes begin now."""
        return self if self.minutes is None else replace(self, until=time.monotonic() + 60.0 * SEARCHED * self.minutes)

    @property
    def in_time(self) -> bool:
        """Whether it may ask further."""
        return time.monotonic() < self.until

    def bounds_of(self, simulator: Simulator) -> tuple[float, float]:
        """Return how many seconds of motion fits with ``simulator`` see, and after how many steps a search looks no further."""
        return (self.fit_lumped_s, self.steps_lumped) if isinstance(simulator, PccSimulator) else (self.fit_s, self.steps)


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


def fit_trials(
    fitting: Problem,
    unseen: Problem | None,
    tasks: Sequence[tuple[Hypothesis, list[np.ndarray]]],
    search: Search,
    best: float = np.inf,
) -> list[Trial]:
    """Return the fitted hypotheses, in order; one that diverges from every start is left out.

    Squared errors are those on ``unseen`` runs, or without any on the fitted runs, each left out in turn. Fits that go on
    slowly where much more is left than ``best``, the mean squared error of a trial that they compete with, end there.
    """
    beaten = 0.5 * BEATEN * best * len(fitting.run_of_bin)
    alone = search.workers if len(tasks) == 1 else 1  # a lone fit shares out the columns of its Jacobians
    jobs = [(fitting, unseen, hypothesis, points, search.iterations, beaten, alone) for hypothesis, points in tasks]
    return [trial for trial in parallel(_fit_trial, jobs, search.workers) if trial is not None]


def _fit_trial(
    fitting: Problem,
    unseen: Problem | None,
    hypothesis: Hypothesis,
    points: list[np.ndarray],
    iterations: int,
    beaten: float = np.inf,
    workers: int = 1,
) -> Trial | None:
    low, high = fitting.space(hypothesis).bounds
    fit: Fit | None = None
    for start in points or [np.zeros(len(low))]:
        limit = beaten if fit is None else min(beaten, BEATEN * fit.cost)
        try:
            found = least_squares(
                lambda u: fitting.residual(hypothesis, u).flat,
                start,
                low,
                high,
                iterations,
                beaten=limit,
                before=fit,
                several=shared_out(fitting, hypothesis, workers),
            )
        except SolverError as error:
            log.debug("%s does not run from its start: %s", hypothesis.label(), error)
            continue
        fit = found if fit is None or unlikelihood(fitting, hypothesis, found) < unlikelihood(fitting, hypothesis, fit) else fit
    if fit is None:
        return None
    try:
        placed = fitting.residual(hypothesis, fit.point).registrations if fitting.register or fitting.mounted else {}
        squares = inside = squares_left_out(fitting, hypothesis, fit, low, high)
        if unseen is not None:
            squares = unseen.residual(hypothesis, fit.point, placed).squares
    except SolverError as error:
        log.info("%s diverges on runs left out and is dropped: %s", hypothesis.label(), error)
        return None
    return Trial(hypothesis, fit, placed, squares, inside)


def unlikelihood(fitting: Problem, hypothesis: Hypothesis, fit: Fit) -> float:
    """Return minus the logarithm of how likely a fit is, but for a constant.

    By its squared error, of which ``ALIKE`` bins tell as much as one, and by how far it is from the simulator's nominal
    parameters, which are known to a factor of two. A lag and a damping may be exchanged: both fit alike then.
    """
    tuned, nominal = fitting.space(hypothesis).tuned(fit.point), fitting.simulator.parameters
    doublings = np.array([np.log2(value / nominal[name]) for name, value in tuned.items()])
    told = len(fitting.run_of_bin) / ALIKE
    return float(0.5 * told * np.log(max(fit.cost, 1e-300)) + 0.5 * np.sum(doublings**2))


def shared_out(
    fitting: Problem, hypothesis: Hypothesis, workers: int, held: Sequence[float] | np.ndarray = ()
) -> Several | None:
    """Return what evaluates residuals in ``workers`` processes, where a simulation takes longer than to tell one of it.

    ``held`` are the first parameters, which stay.
    """
    if workers == 1 or isinstance(fitting.simulator, PccSimulator) or fitting.target == "pressure":
        return None
    return lambda points: parallel(_residual, [(fitting, hypothesis, np.r_[held, point]) for point in points], workers)


def _residual(fitting: Problem, hypothesis: Hypothesis, point: np.ndarray) -> np.ndarray | None:
    try:
        return fitting.residual(hypothesis, point).flat
    except SolverError:
        return None


def squares_left_out(
    fitting: Problem, hypothesis: Hypothesis, fit: Fit, low: np.ndarray, high: np.ndarray, truly: bool = True
) -> np.ndarray:
    """Return squared errors (bins,) of every run as predicted by a fit to the others.

    To first order where that changes little. Where a run seems to be predicted much worse without it, the fit is moved
    on truly, since behind a curve that is nearly vertical a straight line leads anywhere; or, if not ``truly``, that run is
    given the benefit of the doubt. The moment at which something began that lasts is held: no run but that in which it did
    tells it, and none to come asks for it.
    """
    folds, bins, free = fitting.folds, len(fitting.run_of_bin), ~fitting.space(hypothesis).told_once
    rows = len(fit.residual) // bins
    of_row = np.repeat(folds, rows)
    whole, low, high = fit.point, low[free], high[free]
    fit = fit._replace(point=whole[free], jacobian=fit.jacobian[:, free])

    def residual(point: np.ndarray) -> np.ndarray:
        moved = whole.copy()
        moved[free] = point
        return fitting.residual(hypothesis, moved).flat

    error = left_out(fit.jacobian, fit.residual, of_row, low - fit.point, high - fit.point)
    grown = np.bincount(of_row, error**2 - fit.residual**2)
    for fold in np.flatnonzero(grown > FAR_SHARE * 2.0 * fit.cost):
        mine = of_row == fold
        moved = moved_on(residual, fit, ~mine, low, high) if truly else fit.residual
        error[mine] = moved[mine]
    return np.asarray(np.sum(error.reshape(bins, rows) ** 2, axis=1))


class Race(NamedTuple):
    """Fitted hypotheses: those that were fitted to the end, and those that were beaten after a few iterations."""

    finished: list[Trial]
    beaten: list[Trial]


def raced(
    fitting: Problem,
    unseen: Problem | None,
    tasks: Sequence[tuple[Hypothesis, list[np.ndarray]]],
    search: Search,
    against: Trial | None = None,
    patient: bool = False,
    most: int | None = None,
) -> Race:
    """Return the fitted hypotheses; those that are beaten after a few iterations are not fitted to the end.

    They compete with each other and with ``against``, a fitted trial. Whatever is compared was simulated with the same steps:
    long ones leave errors of their own, which differ by law, so that a valve, which costs little, has short ones from the
    beginning. If ``patient``, those that have settled compete with each other only: the last shorter steps take a law with jumps
    farther than a smooth one. No more than the ``most`` best go on, if given.
    """
    first = replace(search, iterations=FIRST_ITERATIONS)
    steps = fitting if fitting.target == "pressure" else fitting.rough
    rival = _as_in(steps, against) if against and tasks else np.inf
    heat = fit_trials(steps, unseen, tasks, first, rival)
    others = min((float(trial.inside.mean()) for trial in heat), default=np.inf)
    ahead = min(rival, others)
    settled = PLAINLY * (others if patient else ahead)

    def may_win(trial: Trial) -> bool:
        left = float(trial.inside.mean())
        return left <= BEATEN * ahead and not (trial.fit.settled and left > settled)

    ahead_of_all = sorted(filter(may_win, heat), key=lambda trial: float(trial.inside.mean()))[:most]
    going = [(t.hypothesis, [t.fit.point]) for t in ahead_of_all]
    finished = fit_trials(fitting, unseen, going, search, ahead)
    done = {trial.hypothesis for trial in finished}
    return Race(finished, [trial for trial in heat if trial.hypothesis not in done])


def _as_in(steps: Problem, trial: Trial) -> float:
    """Return the mean squared error on runs left out that ``trial`` has with the steps of the problem ``steps``."""
    try:
        rough = steps.residual(trial.hypothesis, trial.fit.point).flat
    except SolverError:
        return np.inf
    return float(trial.inside.mean()) * float(rough @ rough) / max(2.0 * trial.fit.cost, 1e-300)


def join(current: Trial, point: np.ndarray) -> np.ndarray:
    """Return the point of ``current`` with the scaled parameters of one more effect put after its effects'."""
    count = len(current.fit.point) - len(current.hypothesis.tuned)
    return np.concatenate([current.fit.point[:count], point, current.fit.point[count:]])


def as_nominal(point: np.ndarray, hypothesis: Hypothesis) -> np.ndarray:
    """Return ``point`` with the simulator's parameters at their nominal values, and a log that is not late."""
    fresh = point.copy()
    fresh[len(point) - len(hypothesis.tuned) :] = 0.0
    return fresh


def from_nominal(point: np.ndarray, hypothesis: Hypothesis) -> list[np.ndarray]:
    """Return the start ``as_nominal`` if a simulator's parameter was retuned far: perhaps in an effect's place."""
    tuned = point[len(point) - len(hypothesis.tuned) :]
    return [as_nominal(point, hypothesis)] if np.abs(tuned).max(initial=0.0) > FAR else []


def of_effects(trial: Trial) -> np.ndarray:
    """Return the point of ``trial`` without what is tuned besides its effects."""
    return trial.fit.point[: len(trial.fit.point) - len(trial.hypothesis.tuned)]


def drop(trial: Trial, choice: Choice) -> np.ndarray:
    """Return the point of ``trial`` without the parameters of one of its effects."""
    return np.delete(trial.fit.point, columns_of(trial, choice))


def axes_of(trial: Trial, choice: Choice) -> dict[str, tuple[Axis, int]]:
    """Return name -> (axis, place in the point of ``trial``) of one effect's parameters."""
    axes = effect_axes(choice)
    return {axis.name: (axis, int(k)) for axis, k in zip(axes, columns_of(trial, choice), strict=True)}


def columns_of(trial: Trial, choice: Choice) -> np.ndarray:
    """Return the places of one effect's parameters in the point of ``trial``."""
    first = 0
    for effect in trial.hypothesis.effects:
        size = len(effect_axes(effect))
        if effect == choice:
            return np.arange(first, first + size)
        first += size
    raise ValueError(f"{choice.label()} is not part of {trial.hypothesis.label()}")
