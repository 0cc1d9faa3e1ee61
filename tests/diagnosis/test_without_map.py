"""Two effects that a map without physics tells as one take its place, and a map of a calibration stays."""

from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import fit_trials
from softrl.diagnosis.search.hypothesise import _without_map
from softrl.diagnosis.search.pairs import best_pairs
from softrl.diagnosis.search.path import Path
from softrl.effects.effect import Effect
from softrl.effects.gain import Gain
from softrl.effects.offset import Offset
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured, made
from tests.diagnosis.test_behind_a_map import mapped

TWO = (Gain(1.25, chamber=0), Offset(-0.06))
CHOICES = [Choice(n) for n in ("command_map", "offset", "crosstalk", "asymmetry", "lag")]
CHOICES += [Choice(n, c) for n in ("gain", "offset", "lag") for c in (0, 1, 2)]


@pytest.mark.parametrize(
    ("hidden", "process", "names"), [(TWO, None, {"gain", "offset"}), ((), mapped, {"command_map"})]
)
def test_two_effects_take_the_place_of_the_map_that_tells_them(
    body: PccSimulator, hidden: tuple[Effect, ...], process: Any, names: set[str]
) -> None:
    config = configured(numerics={"dt_s": 0.02, "rough_dt_s": 0.04})
    runs: tuple[Recording, ...] = made(body, hidden, process=process, sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    travel = float(np.mean([run.position.std(axis=0).max() for run in runs if run.position is not None]))
    judge = Judge(problem, 1e-4 * np.sqrt(3.0 / 5.0), travel, config.thresholds, 0)
    tuned = tuple(body.parameters)
    free = len(tuned)
    retuned = fit_trials(problem, None, [(Hypothesis((), tuned), [np.zeros(free)])], config.search)[0]
    by_map = fit_trials(problem, None, [(Hypothesis((CHOICES[0],), tuned), [np.zeros(15 + free)])], config.search)[0]
    path = Path(by_map, retuned)
    _without_map(problem, judge, CHOICES, config.search, path, lambda line: None)
    assert set(path.best.hypothesis.names) == names
    if hidden:
        assert Choice("gain", 0) in path.best.hypothesis.effects
        gain, offset = sorted(path.best.fit.point[:2], reverse=True)
        assert gain > 0.0 > offset
        pairs = best_pairs(problem.rough_about(retuned.hypothesis, retuned.fit.point), retuned, CHOICES[1:], config.search)
        assert names in [{choice.name for choice in pair.choices} for pair in pairs[:3]]  # or an asymmetry, which is a gain
        assert np.all(np.diff([pair.cost for pair in pairs]) >= 0.0)
    else:
        assert path.best is by_map and not path.tried
