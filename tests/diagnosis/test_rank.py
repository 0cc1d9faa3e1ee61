"""Small and large amounts of an effect are seen before anything is fitted in full."""

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.minimise import Fit
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import Trial, fit_trials
from softrl.diagnosis.search import rank as ranking
from softrl.diagnosis.search.look import Base, Begin, Look
from softrl.diagnosis.search.rank import _begun, rank
from softrl.diagnosis.stage import Config
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


def test_what_does_away_with_most_that_nominal_parameters_leave_is_followed_from_there() -> None:
    nearby, little, most = Begin(0, np.zeros(1), 0.2, 0.2), Begin(1, np.ones(1), -9.0, 0.3), Begin(1, np.ones(1), -4.0, 0.6)
    assert _begun(Look([nearby, little], [{}, {}]), bent=False) == [nearby]
    assert _begun(Look([nearby, little], [{}, {}]), bent=True) == [nearby, little]
    assert _begun(Look([nearby, most, little], [{}, {}]), bent=False) == [nearby, most]


def test_where_the_first_begin_leads_nowhere_another_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that disperses less than a rough step shows has no slope there; what is left there tells nothing of the line."""

    def ended(point: np.ndarray, cost: float) -> Fit:
        return Fit(point, np.ones(4), np.zeros((4, 2)), cost, 0)

    bare = Fit(np.zeros(0), np.ones(4), np.zeros((4, 0)), 2.0, 0)
    base = Base(Trial(Hypothesis((), ()), bare, {}, np.ones(2), np.ones(2)), np.zeros((4, 0)))
    flat, other, there = np.array([0.25, 0.25]), np.array([0.08, 0.0]), np.array([0.36, 0.0])
    begins = [Begin(0, flat, 0.6), Begin(0, other, 0.6)]
    monkeypatch.setattr(ranking, "_first_steps", lambda *_: ended(there, 0.1))
    monkeypatch.setattr(ranking, "_stepped", lambda *_: None)
    monkeypatch.setattr(ranking, "_gain", lambda *_: 1.0)
    leads = [
        ranking._rough_fit(None, [base], Choice("dead_time"), begins, 4, begun, best=0.05, limit=0.1)
        for begun in (ended(flat, 1.9), ended(flat + 1.0, 1.9))
    ]
    np.testing.assert_array_equal(leads[0].point, there)
    np.testing.assert_array_equal(leads[1].point, flat + 1.0)  # it moved, and costs more than the limit: not followed further
