"""What a search has found on its way, and fits that it made: none is made twice."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from softrl.diagnosis.fitting import effort
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Search, Trial, fit_trials, raced
from softrl.diagnosis.search.rank import Lead


@dataclass
class Path:
    """What a search found.

    Attributes
    ----------
    best : the hypothesis that pays
    retuned : the one without effects
    screened : the leads of every round
    tried : for each named effect the alternatives fitted in its place, best first, with their points
    close : effects that in some round were fitted about as well as the best
    most : steps of the body after which it looks no further;  begun : those before it began;  cut_short : whether it did not
    until : ``time.monotonic()`` after which it does not, either
    fitted : fits of hypotheses with less than others, by where they began and what they competed with; None if beaten
    """

    best: Trial
    retuned: Trial
    screened: list[list[Lead]] = field(default_factory=list)
    tried: dict[Choice, list[tuple[Choice, np.ndarray]]] = field(default_factory=dict)
    close: set[Choice] = field(default_factory=set)
    most: float = np.inf
    until: float = np.inf
    begun: int = field(default_factory=lambda: effort.steps)
    cut_short: bool = False
    fitted: dict[tuple[Hypothesis, bytes, bytes], Trial | None] = field(default_factory=dict)

    def goes_on(self) -> bool:
        """Return whether the search may look further: not after too many steps, which is noted, or too long."""
        self.cut_short |= effort.steps - self.begun >= self.most
        return not self.cut_short and time.monotonic() < self.until

    def fit(
        self,
        fitting: Problem,
        tasks: Sequence[tuple[Hypothesis, np.ndarray]],
        search: Search,
        against: Trial | None = None,
    ) -> list[Trial]:
        """Return what ``fit_trials`` returns for one start each; none is fitted twice from the same start.

        Those that a race ``against`` a fitted trial leaves plainly behind are left out.
        """
        rival = against.fit.point.tobytes() if against else b""
        keys = [(hypothesis, point.tobytes(), rival) for hypothesis, point in tasks]
        fresh = {key: task[1] for key, task in zip(keys, tasks, strict=True) if key not in self.fitted}
        starts: dict[Hypothesis, list[np.ndarray]] = {}
        for (hypothesis, *_), point in fresh.items():
            starts.setdefault(hypothesis, []).append(point)
        todo = list(starts.items())
        found: list[Trial] = []
        if todo:
            found = raced(fitting, None, todo, search, against).finished if against else fit_trials(fitting, None, todo, search)
        by_hypothesis = {trial.hypothesis: trial for trial in found}
        self.fitted |= {key: by_hypothesis.get(key[0]) for key in fresh}
        return [trial for key in keys if (trial := self.fitted[key]) is not None]
