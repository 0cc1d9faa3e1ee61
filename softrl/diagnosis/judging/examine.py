"""One part of the pipeline (valve, body, or both at once): search, refit, confirm on held-out runs, list rivals."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from softrl.diagnosis.fitting.form import freed
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, effect_axes, neutral
from softrl.diagnosis.fitting.intervals import Interval, by_effect, intervals, intervals_of_pinned
from softrl.diagnosis.fitting.judge import SHOWN_BESIDE, Gap, Judge, Thresholds
from softrl.diagnosis.fitting.problem import Problem, Residual
from softrl.diagnosis.fitting.trial import (
    Search,
    Trial,
    axes_of,
    columns_of,
    drop,
    fit_trials,
    from_nominal,
    join,
    raced,
)
from softrl.diagnosis.judging.dated import Dating, redated, told_of_dates
from softrl.diagnosis.judging.leftover import (
    Offer,
    explained_by,
    heldout_residual,
    not_understood,
    offer_of,
)
from softrl.diagnosis.judging.rivalry import as_good, asked_again, overtakes
from softrl.diagnosis.judging.rivals import Rival, of_another_chamber, overtaking, plainer, simpler, stand_in, suddenly
from softrl.diagnosis.search.hypothesise import forward
from softrl.diagnosis.search.moves import implausible
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.slim import slim, without_silent
from softrl.effects.library import effect_class
from softrl.recordings.gone import Now
from softrl.recordings.recording import Recording

log = logging.getLogger(__name__)
SWITCHES = 2  # effects that a rival may take the place of once the held-out runs have spoken


@dataclass(frozen=True)
class Part:
    """One part of the pipeline with its data.

    Attributes
    ----------
    title : "command to measured pressure", "measured pressure to motion" or "command to motion"
    problem : on the training runs, as far as fits see them
    heldout : runs
    noise, rounding, travel : m (Pa): of one sample, see ``Data``; rms of what is measured
    choices : effects to consider
    now : where recording had come to at its end
    """

    title: str
    problem: Problem
    heldout: tuple[Recording, ...]
    noise: float
    rounding: float
    travel: float
    choices: tuple[Choice, ...]
    now: Now

    def judge(self, runs: Sequence[Recording], thresholds: Thresholds, seed: int) -> Judge:
        """Return the judge on ``runs``."""
        problem = self.problem.on(runs)
        return Judge(problem, self.floor_of(problem), self.travel, thresholds, seed)

    def floor_of(self, problem: Problem) -> float:
        """Return what noise leaves in a bin of ``problem``, whose runs may have other rates than those of fits."""
        return problem.floor(self.noise, self.rounding)


class Named(NamedTuple):
    """An effect that holds on held-out runs: its parameters, what leaving it out costs there, and what is pinned of it."""

    choice: Choice
    intervals: list[Interval]
    gap: Gap
    pinned: Sequence[Interval] = ()


class Day(NamedTuple):
    """How far a session differs in itself from all together: share of stiffness, turn of the base in rad, and its shift in m."""

    session: str
    stiffer: float
    turn_rad: float
    shift_m: float


class Days(NamedTuple):
    """How far ``each`` session differs, the error above the floor ``left`` with that, m; ``beside``: understood without, too."""

    each: tuple[Day, ...]
    left: float
    beside: bool = False


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
    switched : effects that took the place of one which the training runs preferred, a sentence each
    days : how far sessions differ in themselves, where that is most of what stays, see ``days``
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
    switched: tuple[str, ...] = ()
    days: Days | None = None


def examine(part: Part, search: Search, thresholds: Thresholds, seed: int) -> Finding:
    """Return what is missing in one part, searched on training runs and judged on held-out runs.

    A rival that predicts the held-out runs better for sure, and all runs that its fits did not see, takes the place of the
    effect that the training runs alone preferred; so does what needs fewer numbers to say when it began, where only held-out runs
    show that; a law that it extends by less than counts; and what may begin suddenly where that began so and does not.
    """
    inside = part.judge(part.problem.runs, thresholds, seed)
    path = forward(part.problem, inside, part.problem.tuned, part.choices, search, lambda line: log.info("%s", line))
    judge = part.judge(part.heldout, thresholds, seed)
    dating = Dating(part.problem, judge)
    base, final = (dating.on_heldout(trial) for trial in (path.retuned, path.best))
    before, final = final, dating.of(final)
    for old, new in zip(path.best.hypothesis.effects, final.hypothesis.effects, strict=True):
        path.tried[new] = path.tried.pop(old, [])
    finding = _judged(part, judge, path, base, final, search)
    finding = replace(finding, switched=told_of_dates(before, final, [named.choice for named in finding.named]))
    for _ in range(SWITCHES):
        ahead = overtaking(finding.rivals)
        if ahead is None:
            break
        why = "it predicts the held-out runs better, whose error is then the best of several"
        finding = switched(finding, judge, ahead, why, search)
    fewer = simpler(finding.rivals, finding.final, redated(before, final))
    if fewer is not None:
        finding = switched(finding, judge, fewer, "it does as well, and needs fewer numbers to say when it began", search)
    plain = plainer(judge, finding.rivals, finding.final)
    if plain is not None:
        finding = switched(finding, judge, plain, "what that adds to its law is less than anybody would notice", search)
    sudden = suddenly(finding.rivals, finding.final)
    if sudden is not None:
        finding = switched(finding, judge, sudden, "it does as well, and came about sooner than that may", search)
    return finding


def switched(finding: Finding, judge: Judge, better: Rival, why: str, search: Search) -> Finding:
    """Return the finding with a rival in the place of what the training runs preferred, which is told with the reason ``why``."""
    told = (
        f"{better.choice.label()} takes the place of {better.instead_of.label()}, which the training runs preferred: {why}."
    )
    log.info("%s", told)
    part, path = finding.part, finding.path
    final = _put_in(part, judge, path, finding.final, better, search)
    found = _judged(part, judge, path, finding.base, final, search)
    return replace(found, switched=(*finding.switched, told))


def _judged(part: Part, judge: Judge, path: Path, base: Trial, final: Trial, search: Search) -> Finding:
    """Return what the held-out runs say of ``final``, the hypothesis that a search has found, beside ``base`` without effects."""
    final, named, without = _confirm(part, judge, path, base, final, search)
    offer = offer_of(part.problem, judge, final)
    explained = explained_by(judge, base, final, offer)
    reasons = not_understood(part.problem, judge, final, offer, explained)
    in_vain = explained.share < judge.thresholds.explained_share
    closest = final.hypothesis.label() if reasons and named and in_vain else ""
    if reasons and in_vain:
        final, named, without = base, [], {}
        offer = offer_of(part.problem, judge, final)
        explained = explained_by(judge, base, final, offer)
    rivals = []
    for choice, trial in without.items():
        rivals += _rivals(part, judge, path, final, trial, choice, search)
    before, after = (heldout_residual(judge, trial) for trial in (base, final))
    return Finding(
        part, path, base, final, named, rivals, explained.share, explained.left, bool(reasons), closest, reasons, offer,
        before, after, judge,
    )  # fmt: skip


def _put_in(part: Part, judge: Judge, path: Path, final: Trial, better: Rival, search: Search) -> Trial:
    """Return ``final`` with a rival in the place of one of its effects, which is the rival's rival from now on.

    The other effects are put to the test again beside it.
    """
    mine = final.fit.point[columns_of(final, better.instead_of)]
    others = [pair for pair in path.tried[better.instead_of] if pair[0] != better.choice]
    path.tried[better.choice] = [(better.instead_of, mine), *others]
    inside = part.judge(part.problem.runs, judge.thresholds, judge.seed)
    return asked_again(part.problem, inside, judge, better.trial, part.choices, search, path)


def in_full(final: Trial, choice: Choice) -> tuple[Hypothesis, list[np.ndarray]]:
    """Return ``final`` with all parameters of ``choice``, one of its effects, free again, and the point where it was."""
    whole = choice._replace(pinned=())
    values = {name: final.fit.point[column] for name, (_, column) in axes_of(final, choice).items()}
    mine = [values.get(axis.name, zero) for axis, zero in zip(effect_axes(whole), neutral(whole), strict=True)]
    effects = tuple(whole if effect == choice else effect for effect in final.hypothesis.effects)
    first = columns_of(final, choice)[0]
    point = np.insert(drop(final, choice), first, mine)
    return Hypothesis(effects, final.hypothesis.tuned), [point]


def _confirm(
    part: Part, judge: Judge, path: Path, base: Trial, final: Trial, search: Search
) -> tuple[Trial, list[Named], dict[Choice, Trial]]:
    """Return the final trial less effects that do not pay held out, those that do, and the trial without each.

    Where one of several does not, what was tried in its place is asked before it goes: what the others leave may need one of
    them, and the training runs took the simplest.
    """
    gone: list[Choice] = []
    while final.hypothesis.effects:
        without = _leave_one_out(part, judge, path, base, final, search)
        gaps = {choice: judge.gap(trial.squares, final.squares) for choice, trial in without.items()}
        weakest = min(gaps, key=lambda choice: gaps[choice].value)
        less = without[weakest]
        if _holds(judge, less, final, gaps[weakest], len(gaps) == 1):
            free = freed(part.problem, final)
            found = intervals(part.problem, final, judge.thresholds, free)
            mine = by_effect(final.hypothesis, found)
            pinned = intervals_of_pinned(part.problem, final, judge.thresholds, free)
            return final, [Named(c, mine[c], gaps[c], pinned.get(c, ())) for c in without], without
        log.info("%s does not pay on held-out runs and is not named", weakest.label())
        gone.append(weakest)
        rivals = _rivals(part, judge, path, final, without[weakest], weakest, search) if len(gaps) > 1 else []
        instead = stand_in(judge, without[weakest], [rival for rival in rivals if rival.choice not in gone])
        if instead is None:
            final = _without_silent(part, judge, path, less, search)
        else:
            final = _put_in(part, judge, path, final, instead, search)
    return base, [], {}


def _holds(judge: Judge, less: Trial, final: Trial, gap: Gap, only: bool) -> bool:
    """Return whether the effect that ``final`` has beyond ``less`` pays on held-out runs, as it had to in training.

    An ``only`` one, or one without which a retuned parameter is implausible, just has to show, see ``moves.pays``. Each has to
    stand out beside what stays: where a body is another than its simulator, some law lowers what that leaves a little.
    """
    odd, plain = implausible(judge, final), gap.value >= judge.material
    if only or (not odd and implausible(judge, less)):
        plain = judge.removed(less.squares, final.squares) >= (SHOWN_BESIDE if odd else 1.0) * judge.material
    return plain and gap.low > 0.0 and judge.stands_out(less.squares, final.squares)


def _leave_one_out(
    part: Part, judge: Judge, path: Path, base: Trial, final: Trial, search: Search
) -> dict[Choice, Trial]:
    if len(final.hypothesis.effects) == 1:
        return {final.hypothesis.effects[0]: base}
    tasks = [(final.hypothesis.without(c), drop(final, c)) for c in final.hypothesis.effects]
    fitted = path.fit(part.problem, tasks, search)  # the search asked the same of each that it put to the test
    labels = {trial.hypothesis: trial for trial in Dating(part.problem, judge).that_run(fitted)}
    return {c: labels.get(final.hypothesis.without(c), base) for c in final.hypothesis.effects}


def _rivals(
    part: Part, judge: Judge, path: Path, final: Trial, without: Trial, choice: Choice, search: Search
) -> list[Rival]:
    """Return the best alternatives to ``choice``, the other effects staying, judged on held-out runs."""
    tried = path.tried.get(choice, [])
    others = [pair for pair in tried if pair[0].name not in final.hypothesis.names][: search.rivals]
    others += [pair for pair in tried if of_another_chamber(pair[0], choice)][:1]
    tasks = [
        (without.hypothesis.with_effect(other), [start, *from_nominal(start, without.hypothesis)][: search.starts])
        for other, point in others
        for start in [join(without, point)]
    ]
    race = raced(part.problem, judge.problem, tasks, search, final, patient=True)
    found, both, whole = [], judge.on((*part.problem.runs, *part.heldout)), None
    for trial in map(Dating(part.problem, judge).of, (*race.finished, *race.beaten)):
        alike = as_good(judge, both, trial, final)
        if alike and _freer(trial, final):
            trial = _slimmed(part, judge, path, trial, search)
            if set(trial.hypothesis.effects) == set(final.hypothesis.effects):
                continue
            alike = as_good(judge, both, trial, final) and not _freer(trial, final)
        gap = judge.gap(trial.squares, final.squares)
        better = overtakes(judge, both, trial, final)
        if better and choice.pinned:  # the rival has all its parameters: so must what it is better than
            whole = whole or fit_trials(part.problem, judge.problem, [in_full(final, choice)], search)
            better = all(overtakes(judge, both, trial, one) for one in whole)
        found.append(Rival(choice, trial.hypothesis.effects[-1], gap, alike, trial, better))
    return sorted(found, key=lambda rival: rival.gap.value)


def _freer(trial: Trial, final: Trial) -> bool:
    """Return whether ``trial`` has more parameters than ``final`` and predicts all runs no better for it."""
    return len(trial.fit.point) > len(final.fit.point) and bool(trial.everywhere.mean() > final.everywhere.mean())


def _without_silent(part: Part, judge: Judge, path: Path, trial: Trial, search: Search) -> Trial:
    """Return ``trial`` without parameters that do nothing any more beside what is left, such as a gate that opens at once."""
    if not trial.hypothesis.effects:
        return trial
    inside = part.judge(part.problem.runs, judge.thresholds, judge.seed)
    less = without_silent(part.problem, inside, trial._replace(squares=trial.inside), search, path)
    return next(iter(Dating(part.problem, judge).that_run([less])), trial)


def _slimmed(part: Part, judge: Judge, path: Path, trial: Trial, search: Search) -> Trial:
    """Return ``trial`` with those parameters of its last effect that pay: what was named was slimmed, too.

    A dead time that disperses by nothing is a delay. A map without physics means something with all its parameters only.
    """
    if effect_class(trial.hypothesis.effects[-1].name).together:
        return trial
    inside = part.judge(part.problem.runs, judge.thresholds, judge.seed)
    last = len(trial.hypothesis.effects) - 1
    less = slim(part.problem, inside, trial._replace(squares=trial.inside), search, path, last)
    return next(iter(Dating(part.problem, judge).that_run([less])), trial)
