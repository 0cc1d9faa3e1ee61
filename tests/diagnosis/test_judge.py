"""What pays, and what shows that something is missing although much else stays."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Gate, Hypothesis
from softrl.diagnosis.fitting.judge import Judge
from softrl.diagnosis.fitting.problem import Problem
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


def test_of_equals_the_better_takes_over_only_if_it_is_not_rounding(judge: Judge) -> None:
    def fitted(choice: Choice, mean_square: float, free: int) -> Any:
        fit = SimpleNamespace(point=np.zeros(free))
        return SimpleNamespace(hypothesis=Hypothesis((choice,), ()), mean_square=mean_square, fit=fit)

    takes_over = judge.takes_over
    gain, asymmetry = fitted(Choice("gain", 0), 1.0, 1), fitted(Choice("asymmetry"), 0.9999, 1)
    assert not takes_over(asymmetry, gain) and takes_over(fitted(Choice("asymmetry"), 0.99, 1), gain)
    assert not takes_over(fitted(Choice("asymmetry"), 0.5, 2), gain), "more numbers are not plainer"
    moment = Gate("since_s", 5.0)
    tilted, turned = (fitted(Choice(name, gate=moment), 1.0, 3) for name in ("mount_tilt", "frame"))
    assert takes_over(turned, tilted) and not takes_over(tilted, turned)
    tilted, turned = (fitted(Choice(name, gate=moment), 1.0, free) for name, free in (("mount_tilt", 4), ("frame", 8)))
    assert takes_over(tilted, turned) and not takes_over(turned, tilted), "within a second a mount may lean over"
    tilted.fit.point[2], turned.fit.point[6] = -2.5, -2.5
    assert takes_over(turned, tilted) and not takes_over(tilted, turned), "what moves at once is a camera, for all its numbers"
    two = Choice("frame", pinned=("shift_x", "shift_y", "shift_z", "turn_z_rad"))
    tilt, turn = fitted(Choice("mount_tilt"), 1.0, 2), fitted(two, 0.99, 2)
    assert takes_over(tilt, turn) and not takes_over(turn, tilt), "two numbers picked from six are not as plain as two"
