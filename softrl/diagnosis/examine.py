"""One part of the pipeline (valve, body, or both at once): search, refit, confirm on held-out runs, list rivals."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from softrl.core.errors import SolverError
from softrl.diagnosis.flexible import correction, pressures
from softrl.diagnosis.form import pinned_jacobian, taken_up, weight_error
from softrl.diagnosis.hypothesis import Choice, Hypothesis, effect_axes
from softrl.diagnosis.hypothesise import Path, forward
from softrl.diagnosis.judge import Gap, Judge, Thresholds
from softrl.diagnosis.locate import corrected, locate
from softrl.diagnosis.problem import Problem, Residual
from softrl.diagnosis.search import jacobian_at
from softrl.diagnosis.statistics import (
    MIN_BLOCKS,
    UNSEEN,
    blocks_of,
    correlation_time,
    jackknife,
    sandwich,
    spectral_line,
    unlike_noise,
    whiteness,
)
from softrl.diagnosis.trial import Search, Trial, drop, fit_trials, join, raced
from softrl.recordings.recording import Recording

log = logging.getLogger(__name__)
WHITENESS_LAGS = 20
AT_BOUND = 1e-3  # share of a range at whose ends a parameter is said to be at a bound
NOISE_LEVEL = 0.01  # chance of what is left under noise of its own spectrum
NOISE_DRAWS = 500
DIFFERENCE = 0.02  # scaled step of derivatives
LINE_LEVEL = 1e-8  # chance of a line in the spectrum of noise
FORM_SHARE = 0.05  # of the residual; found on single hidden effects, each fitted by its own law
UNDRIVEN_SHARE = 0.5  # of the squared error: effects that remove less explain nothing
UNKNOWN_TIMES = 1.2  # what is missing must stand out more than what is named: nobody can check it
REST_FACTOR = 2.5  # times what counts: what is left beside effects that explain most of it, and is no detail of them
FOLLOWING_FACTOR = 3.0  # times what counts: structure below this may be a detail of the body
FOLLOWING_LEVEL = 1e-3


@dataclass(frozen=True)
class Part:
    """One part of the pipeline with its data.

    Attributes
    ----------
    title : "command to measured pressure", "measured pressure to motion" or "command to motion"
    problem : on the training runs, as far as fits see them
    heldout : runs
    floor, travel : m (Pa): noise in a bin, rms of what is measured
    tuned : simulator parameters that are refitted
    choices : effects to consider
    """

    title: str
    problem: Problem
    heldout: tuple[Recording, ...]
    floor: float
    travel: float
    tuned: tuple[str, ...]
    choices: tuple[Choice, ...]

    def judge(self, runs: Sequence[Recording], thresholds: Thresholds, seed: int) -> Judge:
        """Return the judge on ``runs``."""
        return Judge(self.problem.on(runs), self.floor, self.travel, thresholds, seed)


class Interval(NamedTuple):
    """A parameter's value and interval."""

    owner: str
    name: str
    unit: str
    value: float
    low: float
    high: float
    at_bound: bool


class Named(NamedTuple):
    """An effect that holds on held-out runs: its parameters, and what leaving it out costs there."""

    choice: Choice
    intervals: list[Interval]
    gap: Gap


class Offer(NamedTuple):
    """A map without physics from pressures and their past to what is left: its held-out gain, and whether it pays."""

    gap: Gap
    pays: bool
    squares: np.ndarray


class Rival(NamedTuple):
    """An alternative to a named effect: how much worse it is held out, and whether the data can tell; its fit."""

    instead_of: Choice
    choice: Choice
    gap: Gap
    equivalent: bool
    trial: Trial


@dataclass(frozen=True)
class Finding:
    """What one part of the pipeline says.

    Attributes
    ----------
    part : which
    path : of the search
    base, final : trials refitted on all training runs, judged on held-out runs: retuned only, and with effects
    named, rivals : effects, and their alternatives
    explained : share of the squared held-out error above the floor that the effects remove
    left : held-out error above the floor that remains, m (Pa)
    unknown : whether something is missing that no effect explains; effects that explain most of it stay named
    closest : the effects that came closest to it, without explaining it
    reasons : why it is unknown, one clause each
    offer : what a map without physics could still remove
    residual_before, residual_after : held-out
    judge : on the held-out runs
    joint : scaled parameters of all parts' effects and the simulator's, where they were refitted from command to motion
    """

    part: Part
    path: Path
    base: Trial
    final: Trial
    named: list[Named]
    rivals: list[Rival]
    explained: float
    left: float
    unknown: bool
    closest: str
    reasons: list[str]
    offer: Offer
    residual_before: Residual
    residual_after: Residual
    judge: Judge
    joint: np.ndarray | None = None


def examine(part: Part, search: Search, thresholds: Thresholds, seed: int) -> Finding:
    """Return what is missing in one part, searched on training runs and judged once on held-out runs."""
    inside = part.judge(part.problem.runs, thresholds, seed)
    path = forward(part.problem, inside, part.tuned, part.choices, search, lambda line: log.info("%s", line))
    judge = part.judge(part.heldout, thresholds, seed)
    base, final = (_on_heldout(judge, trial) for trial in (path.retuned, path.best))
    final, named, without = _confirm(part, judge, base, final, search)
    offer = _offer(part, judge, final)
    explained, left = _explained(judge, base, final, offer)
    reasons = _unexplained(judge, final, offer, explained, left)
    in_vain = explained < thresholds.explained_share
    closest = final.hypothesis.label() if reasons and named and in_vain else ""
    if reasons and in_vain:
        final, named, without = base, [], {}
        offer = _offer(part, judge, final)
        explained, left = _explained(judge, base, final, offer)
    rivals = []
    for choice, trial in without.items():
        rivals += _rivals(part, judge, path, final, trial, choice, search)
    before, after = (_heldout(judge, trial) for trial in (base, final))
    unknown = bool(reasons)
    return Finding(
        part, path, base, final, named, rivals, explained, left, unknown, closest, reasons, offer, before, after, judge
    )


def _explained(judge: Judge, base: Trial, final: Trial, offer: Offer) -> tuple[float, float]:
    """Return (share of the squared error that can be explained which effects explain, error above the floor left).

    What can be explained is what the effects remove, and what a map without physics could remove beyond them. Effects
    that remove less than ``UNDRIVEN_SHARE`` of the whole have to answer for the whole.
    """
    whole, left = float(judge.excess(base.mean_square)), float(judge.excess(final.mean_square))
    removed = whole**2 - left**2
    if removed <= UNDRIVEN_SHARE * whole**2:
        return (removed / whole**2 if whole > 0.0 else 0.0), left
    rest = float(judge.excess(offer.squares.mean())) if offer.pays else left
    return removed / (whole**2 - min(rest, left) ** 2), left


def _offer(part: Part, judge: Judge, trial: Trial) -> Offer:
    """Return what a map from pressures and their past to the residual, fitted on training runs, removes held out."""
    training = part.problem.residual(trial.hypothesis, trial.fit.point, trial.placed)
    heldout = _heldout(judge, trial)
    offered = correction(part.problem, training.runs, judge.problem)
    runs = [values - extra for values, extra in zip(heldout.runs, offered, strict=True)]
    squares = Residual(runs, {}).squares
    return Offer(judge.gap(trial.squares, squares), judge.pays(trial.squares, squares), squares)


def _unexplained(judge: Judge, final: Trial, offer: Offer, explained: float, left: float) -> list[str]:
    """Return why the effects do not explain what is measured, one clause each; empty if they do.

    Noise with a memory is no reason: what is left has to follow the pressures, to be a line in the spectrum, or to be
    unlike noise of its own spectrum. Where effects explain most of it, what is left must follow the pressures plainly.
    """
    if left <= judge.material:
        return []
    follows = offer.pays and judge.stands_out(final.squares, offer.squares, UNKNOWN_TIMES)
    if explained >= judge.thresholds.explained_share:
        plain = follows and left > REST_FACTOR * judge.material
        return ["what the effects named leave follows the pressures and their past"] if plain else []
    heldout, reasons = _heldout(judge, final), []
    drives = [pressures(judge.problem, k) for k in range(len(judge.problem.runs))]
    if follows:
        reasons.append("what is left follows the pressures and their past")
    elif left > FOLLOWING_FACTOR * judge.material and (region := _followed(judge, heldout)):
        reasons.append(f"what is left follows the pressures and their past ({region})")
    elif left > judge.floor and spectral_line(heldout.runs, drives) < LINE_LEVEL:
        reasons.append("what is left swings at one frequency")
    elif left > FOLLOWING_FACTOR * judge.material and _uneven(judge, final, heldout, drives):
        reasons.append("what is left is no noise: it jumps, or grows where the pressures move")
    return reasons


def intervals(problem: Problem, trial: Trial, thresholds: Thresholds) -> list[Interval]:
    """Return every free parameter with its interval, robust to errors that stay alike within blocks and within runs."""
    space = problem.space(trial.hypothesis)
    jacobian, residual = trial.fit.jacobian, trial.fit.residual
    reach = _reach(problem, jacobian, residual, thresholds)
    pinned = pinned_jacobian(problem, trial)
    if pinned.any():
        reach = np.maximum(reach, _with_pinned(problem, jacobian, pinned, residual, reach, thresholds))
    reach = np.hypot(reach, weight_error(problem, trial)) + _step_error(problem, trial)
    found, bounds = [], space.bounds
    for k, axis in enumerate(space.axes):
        u = float(trial.fit.point[k])
        free = bool(trial.fit.jacobian[:, k].any())
        low, high = (u - reach[k], u + reach[k]) if free else (-np.inf, np.inf)
        ends = sorted((axis.physical(float(low)), axis.physical(float(high))))
        value = axis.physical(u)
        low, high = min(ends[0], value), max(ends[1], value)
        at_bound = bool(min(u - bounds[0][k], bounds[1][k] - u) < AT_BOUND * (bounds[1][k] - bounds[0][k]))
        found.append(Interval(axis.owner, axis.name, axis.unit, value, low, high, at_bound))
    return found


def _reach(problem: Problem, jacobian: np.ndarray, residual: np.ndarray, thresholds: Thresholds) -> np.ndarray:
    """Return half the intervals (p,) of least-squares parameters, in scaled units."""
    rows = len(residual) // len(problem.run_of_bin)
    blocks = _independent(problem, residual.reshape(-1, rows), jacobian.shape[1], thresholds)
    spread = np.sqrt(np.diag(sandwich(jacobian, residual, np.repeat(blocks, rows))))
    freedom = max(int(blocks.max()) + 1 - len(spread), 1)
    apart = jackknife(jacobian, residual, np.repeat(problem.folds, rows))
    between = float(stats.t.ppf(thresholds.confidence, int(problem.folds.max()))) * apart
    reach = np.maximum(float(stats.t.ppf(thresholds.confidence, freedom)) * spread, between)
    return np.asarray(np.hypot(reach, _form_error(jacobian, residual)))


def _with_pinned(
    problem: Problem,
    jacobian: np.ndarray,
    pinned: np.ndarray,
    residual: np.ndarray,
    reach: np.ndarray,
    thresholds: Thresholds,
) -> np.ndarray:
    """Return half the intervals (p,) where pinned parameters, of derivatives (rows, q), may have other values as well.

    That the data cannot tell a parameter from its neutral value does not mean that it has it. It is not taken to be
    farther away than plain to see.
    """
    count, both = jacobian.shape[1], np.hstack([jacobian, pinned])
    moved = taken_up(both, residual[:, None])[:count, 0]
    freed = _reach(problem, both, residual, thresholds)[:count] + np.abs(moved)
    return np.asarray(np.minimum(freed, reach + np.abs(taken_up(jacobian, pinned)).sum(axis=1)))


def _independent(problem: Problem, residual: np.ndarray, free: int, thresholds: Thresholds) -> np.ndarray:
    """Return blocks (bins,) as long as errors (bins, channels) stay alike, but enough of them for ``free`` parameters."""
    runs = problem.run_of_bin
    longest = max(
        correlation_time(residual[runs == run, k]) for run in np.unique(runs) for k in range(residual.shape[1])
    )
    length = max(thresholds.block_s / problem.numerics.bin_s, 2.0 * longest)
    return blocks_of(runs, max(int(min(length, len(runs) / (MIN_BLOCKS + 2 * free))), 1))


def _form_error(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return how far the parameters (p,) may be off, in scaled units, because the body is not quite the robot's.

    What is left after the fit holds no part that a parameter could take; but what a body of another form would have left
    may have had one, alike in all runs, which no comparison of runs shows: ``FORM_SHARE`` of it.
    """
    free = jacobian.any(axis=0)
    size = np.linalg.norm(jacobian[:, free], axis=0)
    scaled = jacobian[:, free] / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=UNSEEN, hermitian=True)
    found = np.zeros(jacobian.shape[1])
    found[free] = FORM_SHARE * np.linalg.norm(residual) * np.sqrt(np.diag(inverse)) / size
    return found


def _step_error(problem: Problem, trial: Trial) -> np.ndarray:
    """Return how far the parameters (p,) move as the time step goes to zero, in scaled units.

    One Gauss-Newton step at half the time step, doubled: the integrators are of first order.
    """
    finer = replace(problem, numerics=replace(problem.numerics, dt_s=0.5 * problem.numerics.dt_s))
    try:
        residual = finer.residual(trial.hypothesis, trial.fit.point, trial.placed).flat
    except SolverError:
        return np.zeros(len(trial.fit.point))
    size = np.maximum(np.linalg.norm(trial.fit.jacobian, axis=0), 1e-300)
    scaled = trial.fit.jacobian / size
    moved = np.linalg.solve(scaled.T @ scaled + 1e-6 * np.eye(len(size)), scaled.T @ (residual - trial.fit.residual))
    return np.asarray(np.minimum(2.0 * np.abs(moved / size), 1.0))


def _followed(judge: Judge, residual: Residual) -> str:
    """Return in words what the residual follows beyond chance, or nothing."""
    rows = corrected(locate(judge.problem, residual, judge.floor, ""))
    share = FOLLOWING_FACTOR * judge.material / judge.rms(residual.squares)
    least = max(share, UNKNOWN_TIMES * judge.thresholds.noise_share)
    rows = [row for row in rows if row["effect_size"] > least]
    named = [row for row in rows if row["p_value"] < FOLLOWING_LEVEL and row["region"] not in (None, "band")]
    if not named:
        return ""
    chamber = f", chamber {named[0]['chamber']}" if named[0]["chamber"] else ""
    return f"{named[0]['region']}{chamber}"


def _on_heldout(judge: Judge, trial: Trial) -> Trial:
    """Return the trial with its squared errors on the held-out runs."""
    return trial._replace(squares=_heldout(judge, trial).squares)


def _confirm(
    part: Part, judge: Judge, base: Trial, final: Trial, search: Search
) -> tuple[Trial, list[Named], dict[Choice, Trial]]:
    """Return the final trial less effects that do not pay held out, those that do, and the trial without each."""
    while final.hypothesis.effects:
        without = _leave_one_out(part, judge, base, final, search)
        gaps = {choice: judge.gap(trial.squares, final.squares) for choice, trial in without.items()}
        weakest = min(gaps, key=lambda choice: gaps[choice].value)
        if gaps[weakest].value >= judge.material and gaps[weakest].low > 0.0:
            found = intervals(part.problem, final, judge.thresholds)
            mine = by_effect(final.hypothesis, found)
            return final, [Named(choice, mine[choice], gaps[choice]) for choice in without], without
        log.info("%s does not pay on held-out runs and is not named", weakest.label())
        final = without[weakest]
    return base, [], {}


def _leave_one_out(part: Part, judge: Judge, base: Trial, final: Trial, search: Search) -> dict[Choice, Trial]:
    if len(final.hypothesis.effects) == 1:
        return {final.hypothesis.effects[0]: base}
    tasks = [(final.hypothesis.without(c), [drop(final, c)]) for c in final.hypothesis.effects]
    fitted = fit_trials(part.problem, judge.problem, tasks, search)
    labels = {trial.hypothesis: trial for trial in fitted}
    return {c: labels.get(final.hypothesis.without(c), base) for c in final.hypothesis.effects}


def _rivals(
    part: Part, judge: Judge, path: Path, final: Trial, without: Trial, choice: Choice, search: Search
) -> list[Rival]:
    """Return the best alternatives to ``choice``, the other effects staying, judged on held-out runs."""
    taken = {effect.name for effect in final.hypothesis.effects}
    tasks = [
        (without.hypothesis.with_effect(other), [join(without, point)])
        for other, point in path.tried.get(choice, [])
        if other.name not in taken
    ]
    trials = raced(part.problem, judge.problem, tasks[: search.rivals], search, float(final.inside.mean()))
    found, both = [], judge.on((*part.problem.runs, *part.heldout))
    for trial in trials:
        gap = judge.gap(trial.squares, final.squares)
        freer = len(trial.fit.point) > len(final.fit.point) and trial.everywhere.mean() > final.everywhere.mean()
        alike = not both.tells(trial.everywhere, final.everywhere)
        found.append(Rival(choice, trial.hypothesis.effects[-1], gap, alike and not freer, trial))
    return sorted(found, key=lambda rival: rival.gap.value)


def by_effect(hypothesis: Hypothesis, found: list[Interval]) -> dict[Choice, list[Interval]]:
    """Return the intervals of each effect's parameters."""
    left, sorted_out = list(found), {}
    for choice in hypothesis.effects:
        size = len(effect_axes(choice))
        sorted_out[choice], left = left[:size], left[size:]
    return sorted_out


def _heldout(judge: Judge, trial: Trial) -> Residual:
    return judge.problem.residual(trial.hypothesis, trial.fit.point, trial.placed)


def _uneven(judge: Judge, trial: Trial, residual: Residual, drives: list[np.ndarray]) -> bool:
    """Return whether ``residual`` is neither white nor noise of any other colour, whatever the parameters are."""
    p_values = [whiteness(column, WHITENESS_LAGS)[1] for run in residual.runs for column in run.T]
    if min(p_values) * len(p_values) > NOISE_LEVEL:
        return False
    rng = np.random.default_rng(judge.seed)
    return unlike_noise(residual.runs, drives, NOISE_DRAWS, rng, _slopes(judge, trial, residual)) < NOISE_LEVEL


def _slopes(judge: Judge, trial: Trial, residual: Residual) -> list[np.ndarray]:
    """Return the derivatives (bins, channels, p) of the held-out ``residual``, run by run, by the trial's parameters."""
    low, high = judge.problem.space(trial.hypothesis).bounds

    def moved(point: np.ndarray) -> np.ndarray:
        return judge.problem.residual(trial.hypothesis, point, trial.placed).flat

    columns = jacobian_at(moved, trial.fit.point, residual.flat, low, high, DIFFERENCE)
    ends = np.cumsum([run.size for run in residual.runs])[:-1]
    parts = zip(np.split(columns, ends), residual.runs, strict=True)
    return [part.reshape(*run.shape, -1) for part, run in parts]
