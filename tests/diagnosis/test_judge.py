"""What pays, and what shows that something is missing although much else stays."""

import numpy as np
import pytest

from softrl.diagnosis.judge import Judge
from softrl.diagnosis.problem import Problem
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made


@pytest.fixture(scope="module")
def judge(body: PccSimulator) -> Judge:
    config, runs = configured(), made(body, sessions=2).recordings
    problem = Problem(body.robot, body, runs, config.numerics, "motion", "command", False, False)
    return Judge(problem, 1.0, 1.0 / config.thresholds.material_share, config.thresholds, 0)


def test_the_first_effect_shows_beside_noise_that_is_larger(judge: Judge) -> None:
    noise = 3.0 * np.random.default_rng(0).chisquare(3, len(judge.problem.run_of_bin))
    assert judge.material == pytest.approx(1.0)
    assert judge.shows(noise + 4.0, noise), "4 of 13 in squares are 2 of 3.6"
    assert not judge.pays(noise + 4.0, noise), "the rms error falls by less than counts"
    assert judge.pays(noise + 16.0, noise)


def test_a_body_s_detail_and_a_chance_gain_do_not_show(judge: Judge) -> None:
    rng, count = np.random.default_rng(1), len(judge.problem.run_of_bin)
    noise = 3.0 * rng.chisquare(3, count)
    assert not judge.shows(noise + 1.2, noise)
    alarms = sum(judge.shows(3.0 * rng.chisquare(3, count), 3.0 * rng.chisquare(3, count)) for _ in range(50))
    assert alarms == 0
