"""One effect in the place of all that were found, where it does as well."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, columns_of
from softrl.diagnosis.search.moves import implausible, others_of
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.slim import slim
from softrl.effects.library import effect_class


def alone(fitting: Problem, judge: Judge, choices: Sequence[Choice], search: Search, path: Path) -> Trial | None:
    """Return one of the effects that were tried beside others, by itself, where data cannot tell it from all that were found.

    Two effects of many parameters may bend together to what one law is, whose fit from afar ended elsewhere. Beside them it was
    fitted from near by; from there it is fitted without them. So is what lasted through one session of the ``choices``.
    """
    trial = path.best
    if len(trial.hypothesis.effects) < 2:
        return None
    near = {choice: point for effect in trial.hypothesis.effects for choice, point in path.tried.get(effect, [])[: search.rivals]}
    near |= _mended(trial, choices)
    body = trial.fit.point[len(trial.fit.point) - len(trial.hypothesis.tuned) :]
    tasks = [
        (Hypothesis((choice,), trial.hypothesis.tuned), np.concatenate([point, body]))
        for choice, point in near.items()
        if not effect_class(choice.name).together
    ]
    odd = implausible(judge, trial)
    as_good = [
        slim(fitting, judge, one, search, path)
        for one in path.fit(fitting, tasks, search, trial)
        if not judge.tells(one.squares, trial.squares) and (odd or not implausible(judge, one))
    ]
    fewer = [one for one in as_good if len(one.fit.point) < len(trial.fit.point)]
    if not fewer:
        return None
    found: Trial = judge.simplest(fewer)
    path.tried[found.hypothesis.effects[0]] = [*others_of(as_good, found), *_former(trial, found.hypothesis.effects[0])]
    return found


def _mended(trial: Trial, choices: Sequence[Choice]) -> dict[Choice, np.ndarray]:
    """Return what lasts for ever in ``trial`` as what lasted through a session, where another effect of its chamber tells others.

    A chamber that failed for ever and has another gain on the next day was mended in between. ``choices`` are the forms that the
    recordings can show.
    """
    found = {}
    for old in trial.hypothesis.effects:
        told = {s for other in trial.hypothesis.effects if other.chamber == old.chamber for s in other.sessions}
        for form in choices if told and old.lasting == "ever" else ():
            until = form.lasting == "session" and form.sessions and told.isdisjoint(form.sessions)
            if until and (form.name, form.chamber) == (old.name, old.chamber):
                new = old._replace(lasting="session", sessions=form.sessions)
                found[new] = np.asarray(trial.fit.point[columns_of(trial, old)])
    return found


def _former(trial: Trial, taken: Choice) -> list[tuple[Choice, np.ndarray]]:
    """Return the effects of ``trial`` with their points, other than the one that was ``taken``."""
    others = [choice for choice in trial.hypothesis.effects if choice.name != taken.name]
    return [(choice, np.asarray(trial.fit.point[columns_of(trial, choice)])) for choice in others]
