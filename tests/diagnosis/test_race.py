"""Fits that cannot win end early: who wins, and what is left of the winner, does not change by that."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.problem import Numerics, Problem
from softrl.diagnosis.fitting.trial import PLAINLY, Search, Trial, fit_trials, raced
from softrl.diagnosis.search import path as paths
from softrl.diagnosis.search import rank as ranks
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.rank import rank
from softrl.effects.hysteresis import Hysteresis
from softrl.effects.lag import Lag
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import configured, made

NUMERICS = Numerics(0.02, 0.04, 0.1, 0.0, 4.0)
RIGHT, WRONG = Choice("lag"), Choice("payload")
Setting = tuple[Problem, Trial, Search]


@pytest.fixture
def setting(tripod: Robot, body: PccSimulator) -> Iterator[Setting]:
    """Yield a problem in which a lag is hidden, what retuning leaves of it, and how hard to look."""
    runs = made(body, (Lag(fill_s=0.2, vent_s=0.3),), sessions=3, noise_m=1e-5).recordings
    problem = Problem(tripod, body, runs, NUMERICS, "motion", "command", False, False)
    search = replace(configured().search, workers=1)
    yield problem, fit_trials(problem, None, [(Hypothesis((), tuple(body.parameters)), [])], search)[0], search


def task(retuned: Trial, choice: Choice) -> tuple[Hypothesis, np.ndarray]:
    return retuned.hypothesis.with_effect(choice), np.r_[starts(choice)[0], retuned.fit.point]


def test_what_is_beaten_early_would_have_been_beaten_in_the_end(setting: Setting) -> None:
    problem, retuned, search = setting
    right, wrong = (task(retuned, choice) for choice in (RIGHT, WRONG))
    best = fit_trials(problem, None, [(right[0], [right[1]])], search)[0]
    race = raced(problem, None, [(wrong[0], [wrong[1]])], search, best)
    assert not race.finished and race.beaten[0].hypothesis == wrong[0]
    whole = fit_trials(problem, None, [(wrong[0], [wrong[1]])], search)[0]
    assert whole.mean_square > PLAINLY * best.mean_square
    alone = raced(problem, None, [(wrong[0], [wrong[1]])], search)
    assert not alone.beaten and alone.finished[0].mean_square == pytest.approx(whole.mean_square, rel=0.02)


def test_a_race_against_itself_is_run_to_the_end(setting: Setting) -> None:
    problem, retuned, search = setting
    right = task(retuned, RIGHT)
    best = fit_trials(problem, None, [(right[0], [right[1]])], search)[0]
    again = raced(problem, None, [(right[0], [right[1]])], search, best)
    assert not again.beaten and again.finished[0].fit.cost == pytest.approx(best.fit.cost, rel=1e-3)


def test_no_fit_of_a_path_is_made_twice_and_a_race_is_kept_apart(
    setting: Setting, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, retuned, search = setting
    right, wrong = (task(retuned, choice) for choice in (RIGHT, WRONG))
    path = Path(retuned, retuned)
    best = path.fit(problem, [right], search)[0]
    assert not path.fit(problem, [wrong], search, best)
    kept = path.fit(problem, [wrong], search)[0]
    for name in ("fit_trials", "raced"):
        monkeypatch.setattr(paths, name, lambda *_: pytest.fail("fitted again"))
    assert path.fit(problem, [right], search) == [best]
    assert path.fit(problem, [wrong, right], search) == [kept, best]
    assert not path.fit(problem, [wrong], search, best)


def test_what_is_far_behind_is_not_improved_and_the_best_is_found_the_same(
    tripod: Robot, body: PccSimulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = made(body, (Hysteresis(height=0.1, yield_strain=0.02),), sessions=3, noise_m=1e-4).recordings
    problem = Problem(tripod, body, runs, NUMERICS, "motion", "command", False, False)
    search = replace(configured().search, workers=1)
    retuned = fit_trials(problem, None, [(Hypothesis((), tuple(body.parameters)), [])], search)[0]
    choices = [Choice(name) for name in ("hysteresis", "play", "friction", "power_creep", "viscoelasticity", "drift")]
    asked, replayed = [0], Problem._replayed

    def counted(self: Problem, *given: Any) -> list[Recording]:
        asked[0] += 1
        return replayed(self, *given)

    monkeypatch.setattr(Problem, "_replayed", counted)
    few = rank(problem, retuned, choices, search)
    thrifty = asked[0]
    monkeypatch.setattr(ranks, "FAR_BEHIND", np.inf)
    monkeypatch.setattr(ranks, "HOPE", -np.inf)
    many = rank(problem, retuned, choices, search)
    assert thrifty < 0.8 * (asked[0] - thrifty)
    assert [lead.choice.name for lead in few[:2]] == [lead.choice.name for lead in many[:2]] == ["hysteresis", "play"]
    np.testing.assert_array_equal(few[0].point, many[0].point)
