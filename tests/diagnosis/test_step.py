"""A slow robot is replayed with longer steps, a fast one is not, and what that changes stays below what counts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.step import FITTED_SHARE, suited
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import configured

LOADED = Hypothesis((Choice("payload"),), ())


def body_alone(body: PccSimulator, speed: float) -> Problem:
    time = 0.02 * np.arange(1, 1001)
    pressure = np.outer(8e3 * (1.0 - np.cos(speed * time)), [1.0, 0.3, 0.0])
    run = Recording("run", "day", time, pressure, None, np.zeros((1000, 3)))
    return Problem(body.robot, body, (run,), configured().numerics, "motion", "command", False, False)


def test_steps_follow_the_motion(body: PccSimulator) -> None:
    slow, fast = body_alone(body, 0.2), body_alone(body, 30.0)
    material, empty = 1e-4, Hypothesis((), ())
    assert suited(fast, material) == fast.numerics
    longer = suited(slow, material)
    assert longer.dt_s > slow.numerics.dt_s and longer.rough_dt_s > slow.numerics.rough_dt_s
    for problem in (slow, body_alone(body, 3.0), body_alone(body, 12.0)):
        stretched = replace(problem, numerics=suited(problem, material))
        for hypothesis, point in ((empty, np.zeros(0)), (LOADED, starts(LOADED.effects[0])[0])):
            moved = [np.concatenate(p.residual(hypothesis, point).runs) for p in (problem, stretched)]
            assert np.sqrt(np.mean(np.sum((moved[1] - moved[0]) ** 2, axis=1))) <= FITTED_SHARE * material


def test_a_body_that_bears_no_load_is_tried_without(body: PccSimulator, monkeypatch: pytest.MonkeyPatch) -> None:
    solved = PccSimulator._run

    def gives_way(self: PccSimulator, *arguments: Any) -> Any:
        if len(arguments[-1][1][0]) > 0:
            raise SolverError("it does not bear this")
        return solved(self, *arguments)

    monkeypatch.setattr(PccSimulator, "_run", gives_way)
    problem = body_alone(body, 0.2)
    assert suited(problem, 1e-4).dt_s > problem.numerics.dt_s
