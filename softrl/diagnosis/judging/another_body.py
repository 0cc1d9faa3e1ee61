"""A lumped body that is not what its file says: longer, or stiffer at one end. Taken where it does as well as what was found."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from softrl.core.simulator import Simulator
from softrl.diagnosis.checks.data import Data
from softrl.diagnosis.checks.reach import as_it_stands, stands_for_length
from softrl.diagnosis.fitting.hypothesis import MASS, Choice, Hypothesis, effect_axes, starts
from softrl.diagnosis.fitting.intervals import intervals
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, columns_of, drop, fit_trials
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.search.moves import implausible
from softrl.pcc.simulator import TAPER, PccSimulator
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
WEIGHED = 1.25  # who weighs a robot, with what moves of its tubes, errs by less
LIKE_A_LENGTH = 0.25  # of what a length seems to be wrong by: an effect that moves the tip at rest by more may be it
PLAINER = 1.2  # times the error that another body may leave, where fewer effects are named with it

Examine = Callable[[Problem, list[Finding]], list[Finding]]


def with_its_length(
    whole: Problem, data: Data, judge: Judge, choices: Sequence[Choice], examine: Examine, search: Search
) -> tuple[Problem, list[Finding]]:
    """Return the problem and its findings, of a body as long as its tip at rest tells where that does as well.

    A tape tells a length to a per cent, and a shift along the body that is named for the rest looks alike. So does a load that
    presses the body: where retuning does not say beforehand that it is the length, what is named moves the tip at rest, or the
    mass is another than a scale would show, the length of the robot's file is asked as well, and stays unless a shift is named
    with it, or the other says more with less. Where neither is understood that is taken which errs less. ``judge`` scores on the
    training runs, on which one of the ``choices`` may press; ``examine`` takes the problem and what was found of the valve, which
    stays.
    """
    body = as_it_stands(whole.simulator, data.training, whole.robot)
    if whole.register or body is whole.simulator:
        return whole, examine(whole, [])
    other = replace(whole, simulator=body)
    if _is_the_length(whole.on(data.training), other.on(data.training), judge, choices, search):
        log.info("the body is taken to be as long as its tip at rest tells")
        again = examine(other, [])
        if not search.in_time or not _may_be_pressed(again[-1], body.length_m - whole.simulator.length_m):
            return other, again
        log.info("the body is examined again with the length of its file, beside which what is missing may look otherwise")
        findings = examine(whole, again[:-1])
        if again[-1].unknown and findings[-1].unknown:
            return (other, again) if again[-1].final.mean_square < findings[-1].final.mean_square else (whole, findings)
    else:
        findings = examine(whole, [])
        if not search.in_time or not (findings[-1].named or findings[-1].unknown):
            return whole, findings
        log.info("the body is examined again as long as its tip at rest tells: a length said wrongly may be what was found")
        again = examine(other, findings[:-1])
    likelier = _shifted(findings[-1]) or _says_more_with_less(again[-1], findings[-1], body.length_m - whole.simulator.length_m)
    better = likelier and does_as_well(again[-1], findings[-1], more=False)
    return (other, again) if better else (whole, findings)


def with_its_mass(
    whole: Problem, findings: list[Finding], examine: Examine, search: Search
) -> tuple[Problem, list[Finding]]:
    """Return the problem and its ``findings``, or those of a body of about the mass that its file says where these do better.

    A load in every run is retuned away if the mass may be any. Of what does as well the mass that a scale would show is taken;
    with it another effect may be named if that errs by less, however little that is. ``examine`` is as above.
    """
    last = findings[-1]
    if not search.in_time or last.unknown or _weighs_as_told(last):
        return whole, findings
    log.info("the body is examined again with a mass that a scale would show: a load may have been retuned away")
    problem = replace(whole, numerics=replace(whole.numerics, mass_factor=min(whole.numerics.mass_factor, WEIGHED)))
    again = examine(problem, findings[:-1])
    loaded = len(again[-1].named) == len(last.named) + 1 and last.judge.tells(last.final.squares, again[-1].final.squares)
    better = not again[-1].unknown and (loaded or does_as_well(again[-1], last, more=False))
    return (problem, again) if better else (whole, findings)


def with_its_taper(
    whole: Problem, findings: list[Finding], examine: Examine, search: Search
) -> tuple[Problem, list[Finding]]:
    """Return the problem and its ``findings``, or those of a body whose stiffness may change along it where these do better.

    It is not asked before everything else: a lag looks like damping where more is retuned. ``examine`` is as above.
    """
    body = tapering(whole, findings[-1], search) if search.in_time else None
    if body is None:
        return whole, findings
    log.info("the body is examined again with a stiffness that may change along it: a taper, or a clamp that gives, may be left")
    problem = replace(whole, simulator=body)
    again = examine(problem, findings[:-1])
    return (problem, again) if does_as_well(again[-1], findings[-1], more=True) else (whole, findings)


def _is_the_length(whole: Problem, other: Problem, judge: Judge, choices: Sequence[Choice], search: Search) -> bool:
    """Return whether retuning with the ``other`` length does better than with its own, and as well as any load beside that."""
    own, longer = (_retuned(problem, [()], search) for problem in (whole, other))
    if not (own and longer) or not judge.tells(own[0].squares, longer[0].squares):
        return False
    loads = [(choice,) for choice in choices if choice.site == "load" and choice == Choice(choice.name)]
    return not any(judge.tells(longer[0].squares, loaded.squares) for loaded in _retuned(whole, loads, search))


def _retuned(problem: Problem, several: Sequence[tuple[Choice, ...]], search: Search) -> list[Trial]:
    """Return the simulator retuned with each of ``several`` effects, where that runs, in the steps of rough fits."""
    begins = problem.space(Hypothesis((), problem.tuned)).begins
    tasks = [
        (Hypothesis(effects, problem.tuned), [np.concatenate([*(starts(effect)[0] for effect in effects), at]) for at in begins])
        for effects in several
    ]
    return fit_trials(problem.rough, None, tasks, search)


def _may_be_pressed(finding: Finding, longer_m: float) -> bool:
    """Return whether a load may be what a length of ``longer_m`` more was taken for.

    Where nothing is understood, what is named moves the tip at rest, or the mass is another than a scale would show.
    """
    return (
        finding.unknown
        or not _weighs_as_told(finding)
        or _rests_elsewhere(finding, longer_m)
    )


def _says_more_with_less(again: Finding, last: Finding, longer_m: float) -> bool:
    """Return whether a body that is ``longer_m`` more gives an answer where there was none, or one of fewer numbers.

    A map may be bent for a length. The mass is one that a scale would show; what moved the tip at rest was no length.
    """
    numbers, before = (sum(len(effect_axes(named.choice)) for named in found.named) for found in (again, last))
    plainer = numbers < before and not _rests_elsewhere(last, longer_m)
    return _weighs_as_told(again) and ((last.unknown and not again.unknown) or plainer)


def _weighs_as_told(finding: Finding) -> bool:
    """Return whether the body's mass was retuned to one that may be by what a scale shows."""
    problem, trial = finding.part.problem, finding.final
    retuned = problem.space(trial.hypothesis).tuned(trial.fit.point).get(MASS, 1.0)
    return 1.0 / WEIGHED <= retuned / problem.simulator.parameters.get(MASS, 1.0) <= WEIGHED


def _rests_elsewhere(finding: Finding, longer_m: float) -> bool:
    """Return whether anything that is named moves the tip at rest by as much as a body ``longer_m`` more might."""
    return any(abs(_moves_at_rest(finding, named.choice)) > LIKE_A_LENGTH * abs(longer_m) for named in finding.named)


def _moves_at_rest(finding: Finding, choice: Choice) -> float:
    """Return how far along the base's axis an effect of the ``finding`` moves the tip where runs begin, m; the median of all."""
    problem, trial = finding.part.problem, finding.final
    tasks = (trial.hypothesis, trial.fit.point), (trial.hypothesis.without(choice), drop(trial, choice))
    first = [[np.asarray(run.position)[0, 2] for run in problem.replayed(*task, ("position",))] for task in tasks]
    return float(np.median(np.subtract(*first)))


def tapering(whole: Problem, last: Finding, search: Search) -> Simulator | None:
    """Return the body with its taper free, where that explains part of what is left, or of what a shift was named for.

    Asked where something that counts is left, where there is such a shift, or a retuned parameter is at the end of its range.
    """
    body = whole.simulator
    if not isinstance(body, PccSimulator) or body.retune_taper:
        return None
    counts = last.unknown or last.left >= last.judge.material
    if not (counts or _shifted(last) or implausible(last.judge, last.final)):
        return None
    free = replace(body, retune_taper=True)
    bare = _without_shifts(last.final)
    tasks = [bare, _freed(bare, last.part.problem, free)]
    fitted = [_fitted(last, task, simulator, search) for task, simulator in zip(tasks, (body, free), strict=True)]
    return free if None not in fitted and last.judge.tells(*(trial.squares for trial in fitted if trial)) else None


def does_as_well(again: Finding, last: Finding, more: bool) -> bool:
    """Return whether another body does as well as what was ``last`` found.

    With fewer effects it may err a little more: a shift along the body is another number that a fit may bend. With as many it has
    to do better if it has ``more`` parameters. An answer where there was none may name one effect more.
    """
    if again.unknown != last.unknown:
        return last.unknown and len(again.named) <= len(last.named) + 1
    if len(again.named) > len(last.named):
        return False
    if len(again.named) == len(last.named):
        tells = last.judge.tells
        return tells(last.final.squares, again.final.squares) if more else not tells(again.final.squares, last.final.squares)
    errs, erred = (float(last.judge.excess(found.final.mean_square)) for found in (again, last))
    return errs <= max(PLAINER * erred, erred + last.judge.material)


def told_of_taper(simulator: Simulator, tuned: dict[str, float]) -> list[str]:
    """Return in a sentence how the body's stiffness was found to change along it, if that was retuned."""
    if not isinstance(simulator, PccSimulator) or not simulator.retune_taper:
        return []
    return [
        f"The body's bending stiffness was let change along it: at the base it is {tuned[TAPER]:.3g} times that at the tip "
        f"({TAPER}, {simulator.stiffness_base_to_tip:.3g} before). A taper, or a clamp that gives, shows so."
    ]


def told_of_mass(last: Finding, robot: Robot) -> list[str]:
    """Return in a sentence what the body's mass was retuned to, where a scale would surely show another, or that it was held.

    What hangs at the tip in every run acts on a lumped body nearly as more mass does: retuning takes it, and nothing is missing.
    """
    if last.part.problem.target != "motion" or last.unknown:
        return []
    of_file, nominal = f"robot.mass_kg={robot.mass_kg:g}", last.part.problem.simulator.parameters.get(MASS, 1.0)
    if (most := last.part.problem.numerics.mass_factor) <= WEIGHED:
        return [f"The body's mass was let be {most:g} times {of_file} at most, or as much less: with more a load may hide in it."]
    return [
        f"The body's mass was retuned to {told.value:.3g} ({told.low:.3g} to {told.high:.3g}) times {of_file}: weigh the robot. "
        "If the file is right, mass that is not spread evenly along the body, as an end plate is, shows so, or a load at the tip "
        "in every run."
        for told in intervals(last.part.problem, last.final, last.judge.thresholds)
        if told.name == MASS and not told.at_bound and not told.low / WEIGHED <= nominal <= told.high * WEIGHED
    ]


def _shifted(last: Finding) -> bool:
    found = [*last.path.best.hypothesis.effects, *(named.choice for named in last.named)]
    return any(stands_for_length(choice) for choice in found)


def _without_shifts(trial: Trial) -> tuple[Hypothesis, np.ndarray]:
    """Return the hypothesis and the point of ``trial`` without what may be a shift along the body."""
    shifts = [choice for choice in trial.hypothesis.effects if stands_for_length(choice)]
    gone = [column for choice in shifts for column in columns_of(trial, choice)]
    kept = tuple(choice for choice in trial.hypothesis.effects if choice not in shifts)
    return Hypothesis(kept, trial.hypothesis.tuned), np.delete(trial.fit.point, gone)


def _freed(task: tuple[Hypothesis, np.ndarray], problem: Problem, free: Simulator) -> tuple[Hypothesis, np.ndarray]:
    """Return the same hypothesis with one more parameter of the body retuned, which begins at its nominal value."""
    hypothesis, point = task
    tuned = replace(problem, simulator=free).tuned
    first = len(point) - len(hypothesis.tuned) + tuned.index(TAPER)
    return Hypothesis(hypothesis.effects, tuned), np.insert(point, first, 0.0)


def _fitted(last: Finding, task: tuple[Hypothesis, np.ndarray], simulator: Simulator, search: Search) -> Trial | None:
    fitting, unseen = (replace(problem, simulator=simulator) for problem in (last.part.problem, last.judge.problem))
    return next(iter(fit_trials(fitting, unseen, [(task[0], [task[1]])], search)), None)
