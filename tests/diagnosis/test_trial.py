"""Of fits that are equally good the one nearer to the nominal simulator is kept."""

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.minimise import Fit
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import from_nominal, unlikelihood
from softrl.effects.lag import Lag
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made


def test_a_lag_and_a_damping_are_not_exchanged(body: PccSimulator) -> None:
    config = configured()
    runs = made(body, (Lag(0.15, 0.15),), sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    hypothesis = Hypothesis((), tuple(body.parameters))
    damping = list(body.parameters).index("damping_s")
    far = np.zeros(len(body.parameters))
    far[damping] = np.log(3.0)

    def fit(point: np.ndarray, cost: float) -> Fit:
        return Fit(point, np.zeros(0), np.zeros((0, 0)), cost, 0)

    near = 0.0 * far
    assert unlikelihood(problem, hypothesis, fit(near, 1.0)) < unlikelihood(problem, hypothesis, fit(far, 0.999))
    assert unlikelihood(problem, hypothesis, fit(near, 1.0)) > unlikelihood(problem, hypothesis, fit(far, 0.9))
    assert not from_nominal(near, hypothesis)
    np.testing.assert_array_equal(from_nominal(far, hypothesis), [near])
