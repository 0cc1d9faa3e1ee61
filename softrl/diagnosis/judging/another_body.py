"""A lumped body that is not what its file says: longer, or stiffer at one end. Taken where it does as well as what was found."""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from softrl.core.simulator import Simulator
from softrl.diagnosis.checks.data import Data
from softrl.diagnosis.checks.reach import as_it_stands, stands_for_length
from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, columns_of, fit_trials
from softrl.diagnosis.judging.examine import Finding
from softrl.diagnosis.search.moves import implausible
from softrl.pcc.simulator import TAPER, PccSimulator

log = logging.getLogger(__name__)
PLAINER = 1.2  # times the error that another body may leave, where fewer effects are named with it

Examine = Callable[[Problem, list[Finding]], list[Finding]]


def with_another_body(
    whole: Problem, data: Data, findings: list[Finding], examine: Examine, search: Search
) -> tuple[Problem, list[Finding]]:
    """Return the problem and its ``findings``, or those of another body where that does as well as what was found.

    First the length that the tip at rest tells is asked, then whether bending stiffness changes along the body. Neither is asked
    before everything else: a load that presses the body looks like a length, and a lag like damping where more is retuned.
    ``examine`` takes the problem and what was found of the valve, which stays.
    """
    bodies = (
        (as_long_as_it_stands, "as long as its tip at rest tells: a length said wrongly"),
        (tapering, "with a stiffness that may change along it: a taper, or a clamp that gives,"),
    )
    for other, words in bodies:
        body = other(whole, data, findings[-1], search)
        if body is None:
            continue
        log.info("the body is examined again %s may be what was found", words)
        problem = replace(whole, simulator=body)
        again = examine(problem, findings[:-1])
        if does_as_well(again[-1], findings[-1], more=body.parameters != whole.simulator.parameters):
            whole, findings = problem, again
    return whole, findings


def as_long_as_it_stands(whole: Problem, data: Data, last: Finding, _: Search) -> Simulator | None:
    """Return the body as long as its tip at rest tells, where a shift along the body was found, which looks alike."""
    body = as_it_stands(whole.simulator, data.training, whole.robot)
    return None if whole.register or body is whole.simulator or not _shifted(last) else body


def tapering(whole: Problem, _: Data, last: Finding, search: Search) -> Simulator | None:
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
