"""What two effects bend to together is told by one law, where one does as well; two that are there stay."""

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import fit_trials
from softrl.diagnosis.search.alone import alone
from softrl.diagnosis.search.path import Path
from softrl.effects.effect import Effect
from softrl.effects.frame import Frame
from softrl.effects.strain_stiffening import StrainStiffening
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

NOISE_M, TRAVEL_M = 6e-5, 0.03
TURNED = Frame(0.05, 0.0, 0.0, 0.02, 0.0, 0.0)


@pytest.mark.parametrize(("beside", "taken"), [pytest.param((), True, marks=pytest.mark.slow), ((TURNED,), False)])
def test_one_law_takes_the_place_of_two_where_it_does_as_well(
    body: PccSimulator, beside: tuple[Effect, ...], taken: bool
) -> None:
    config = configured()
    runs = made(body, (StrainStiffening(0.4, 4.0), *beside), sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    judge = Judge(problem, NOISE_M, TRAVEL_M, config.thresholds, 0)
    growth, frame, law = Choice("area_growth"), Choice("frame"), Choice("strain_stiffening")
    start = np.r_[starts(growth)[0], starts(frame)[0], np.zeros(len(problem.tuned))]
    two = fit_trials(problem, None, [(Hypothesis((growth, frame), problem.tuned), [start])], config.search)[0]
    path = Path(two, two, tried={growth: [(law, starts(law)[0])]})
    found = alone(problem, judge, [growth, frame, law], config.search, path)
    if not taken:
        assert found is None
        return
    assert found is not None and found.hypothesis.effects[0].name == "strain_stiffening"
    told = problem.space(found.hypothesis).values(found.fit.point)
    assert told[:2] == pytest.approx([0.4, 4.0], rel=0.1)
    assert [choice for choice, _ in path.tried[found.hypothesis.effects[0]]] == [growth, frame]
