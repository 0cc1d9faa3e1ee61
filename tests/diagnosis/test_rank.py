"""Small and large amounts of an effect are seen before anything is fitted in full."""

import numpy as np
import pytest

from softrl.diagnosis.hypothesis import Choice, Hypothesis
from softrl.diagnosis.look import Begin, Look
from softrl.diagnosis.problem import Problem
from softrl.diagnosis.rank import _begun, rank
from softrl.diagnosis.stage import Config
from softrl.diagnosis.trial import fit_trials
from softrl.effects.stiffness_scale import StiffnessScale
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made


@pytest.mark.parametrize("scale", [0.6, 0.98, 1.02, 3.0])
def test_a_wall_that_is_stiffer_or_softer_by_little_or_much_is_seen(body: PccSimulator, scale: float) -> None:
    config: Config = configured()
    runs = made(body, (StiffnessScale(scale, chamber=1),), sessions=3, noise_m=1e-5).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    tuned = tuple(body.parameters)
    retuned = fit_trials(problem, None, [(Hypothesis((), tuned), [np.zeros(len(tuned))])], config.search)[0]
    choices = [Choice("stiffness_scale", k) for k in range(3)] + [Choice("stiffness_scale")]
    first = rank(problem, retuned, choices, config.search)[0]
    assert first.choice.chamber == 1
    assert first.gain > 0.9


def test_an_effect_that_promises_nothing_has_a_begin_all_the_same() -> None:
    look = Look([Begin(0, np.zeros(1), -0.2), Begin(0, np.ones(1), -0.5)], [{}])
    assert [begin.share for begin in _begun(look, bent=False)] == [-0.2]
