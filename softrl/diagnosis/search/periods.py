"""In which sessions an effect may act alone: of many periods those are tried that straight lines favour."""

from collections.abc import Sequence

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Choice
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.search.look import Base
from softrl.diagnosis.search.partly import pieces_of

LIKELY = 2  # periods of every effect that are looked at further


def likely(fitting: Problem, base: Base, choices: Sequence[Choice]) -> list[Choice]:
    """Return ``choices`` without the periods of an effect that seem to save less than others of it."""
    forms: dict[Choice, list[Choice]] = {}
    for choice in choices:
        if choice.sessions:
            forms.setdefault(choice._replace(sessions=()), []).append(choice)
    left: set[Choice] = set()
    for everywhere, periods in forms.items():
        if len(periods) > LIKELY:
            pieces = pieces_of(fitting, base, everywhere, fitting.run_of_bin)
            acts = [np.array([run.session in form.sessions for run in fitting.runs]) for form in periods]
            order = np.argsort([-pieces.saved(runs) for runs in acts], kind="stable")
            left |= {periods[k] for k in order[LIKELY:]}
    return [choice for choice in choices if choice not in left]
