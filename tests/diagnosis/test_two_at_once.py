"""Two effects are found at once where the one that came first hides both."""

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import fit_trials
from softrl.diagnosis.search.hypothesise import _two_at_once
from softrl.diagnosis.search.path import Path
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

CHOICES = [Choice(name) for name in ("crosstalk", "hysteresis", "lag", "payload", "gain", "delay")]


@pytest.mark.parametrize("wrong", ["crosstalk", "hysteresis"])
def test_two_effects_take_the_place_of_what_explains_part_of_both(body: PccSimulator, wrong: str) -> None:
    config = configured(numerics={"dt_s": 0.02, "rough_dt_s": 0.04})
    hidden = (Hysteresis(0.15, 0.02), Lag(fill_s=0.2, vent_s=0.3))
    runs = made(body, hidden, sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    travel = float(np.mean([run.position.std(axis=0).max() for run in runs if run.position is not None]))
    judge = Judge(problem, 1e-4 * np.sqrt(3.0 / 5.0), travel, config.thresholds, 0)
    tuned = tuple(body.parameters)
    choice, at = Choice(wrong), np.zeros(len(tuned))
    retuned = fit_trials(problem, None, [(Hypothesis((), tuned), [at])], config.search)[0]
    misled = fit_trials(problem, None, [(Hypothesis((choice,), tuned), [np.r_[starts(choice)[0], at]])], config.search)[0]
    path, said = Path(misled, retuned), []
    assert _two_at_once(problem, judge, CHOICES, config.search, path, said.append)
    assert set(path.best.hypothesis.names) == {"hysteresis", "lag"} and "both at once" in said[0]
    assert all(path.tried.get(effect) for effect in path.best.hypothesis.effects), "each has rivals"
    found, said = path.best, []
    assert not _two_at_once(problem, judge, CHOICES, config.search, path, said.append)
    assert path.best is found and not said, "little stays"
