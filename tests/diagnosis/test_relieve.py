"""A load whose weight was retuned away is named once a retuned mass that went far is asked for its reason."""

import numpy as np
import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.trial import fit_trials
from softrl.diagnosis.search.moves import implausible
from softrl.diagnosis.search.path import Path
from softrl.diagnosis.search.relieve import relieved
from softrl.diagnosis.stage import run
from softrl.effects.payload import Payload
from softrl.effects.power_creep import PowerCreep
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

NOISE_M, TRAVEL_M = 6e-5, 0.03


@pytest.mark.slow
def test_a_heavy_load_on_a_creeping_wall_is_found_behind_a_mass_at_the_end_of_its_range(body: PccSimulator) -> None:
    heavier = body.with_parameters(mass_scale=1.35)
    recordings = made(heavier, (PowerCreep(share=0.5, exponent=0.15), Payload(mass=1.2)))
    config = configured(candidates=["power_creep", "payload", "marker_offset", "offset", "frame"])
    found = run(config, body.robot, recordings, body, tracker=NullTracker())
    assert sorted(effect["name"] for effect in found.effects) == ["payload", "power_creep"], found.sentences
    load = next(effect for effect in found.effects if effect["name"] == "payload")["parameters"]["mass"]
    assert load["low"] <= 1.2 <= load["high"]


@pytest.mark.parametrize(("mass", "at_the_end"), [(0.6, False), (0.9, True)])
def test_a_load_takes_the_place_of_what_needs_a_mass_several_times_nominal(
    body: PccSimulator, mass: float, at_the_end: bool
) -> None:
    config = configured()
    runs = made(body, (PowerCreep(share=0.5, exponent=0.15), Payload(mass=mass)), sessions=3).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    judge = Judge(problem, NOISE_M, TRAVEL_M, config.thresholds, 0)
    creep, marker = Choice("power_creep"), Choice("marker_offset")
    start = np.r_[starts(creep)[0], np.zeros(3 + len(problem.tuned))]
    wrong = fit_trials(problem, None, [(Hypothesis((creep, marker), problem.tuned), [start])], config.search)[0]
    assert problem.space(wrong.hypothesis).tuned(wrong.fit.point)["mass_scale"] > 2.0
    assert implausible(judge, wrong) == at_the_end
    others = [Choice(name) for name in ("payload", "offset", "frame", "gain")]
    found = relieved(problem, judge, others, config.search, Path(wrong, wrong))
    assert found is not None and found.hypothesis.names == ("power_creep", "payload")
    assert found.mean_square < wrong.mean_square
