"""A slow robot is replayed with longer steps, a fast one is not, and what that changes stays below what counts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from softrl.core.errors import SolverError
from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis, starts
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.fitting.step import FITTED_SHARE, suited, within_rows
from softrl.effects.chain import Plant, chain_of
from softrl.effects.flow_limit import FlowLimit
from softrl.effects.replay import replay
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


def test_steps_go_into_the_time_between_rows(body: PccSimulator) -> None:
    """A flow that is limited takes what is asked for within a step as a whole: a step across a row leaves half a millimetre."""
    assert within_rows(0.01, 0.02) == within_rows(0.01, 0.005) == within_rows(0.01, 0.0) == 0.01
    found_s = [within_rows(0.02, 0.05), within_rows(0.01, 0.025), within_rows(0.01, 0.0201)]
    np.testing.assert_allclose(found_s, [1 / 60, 1 / 120, 0.01005])
    rng, time = np.random.default_rng(0), 0.05 * np.arange(1, 401)
    run = Recording("run", "day", time, np.repeat(rng.uniform(0.0, 3e4, (20, 3)), 20, axis=0), None, np.zeros((400, 3)))
    problem = Problem(body.robot, body, (run,), configured().numerics, "motion", "command", False, False)
    numerics, plant = suited(problem, 1e-3), Plant(body, chain_of(body.robot, [FlowLimit(0.4, 0.5)]))
    exact, found, across = (replay(plant, run, dt_s).position for dt_s in (0.0025, numerics.dt_s, 0.02))
    assert numerics.dt_s == pytest.approx(1 / 60) and exact is not None and found is not None and across is not None
    error, without = (np.sqrt(np.mean((moved - exact) ** 2)) for moved in (found, across))
    assert error < 1e-4 < without and error < 0.2 * without, (error, without)
    uneven = replace(problem, runs=(replace(run, time=np.sort(time + rng.uniform(-0.01, 0.01, 400))),))
    assert suited(uneven, 1e-3).dt_s in (0.01, 0.02)


def test_a_body_that_bears_no_load_is_tried_without(body: PccSimulator, monkeypatch: pytest.MonkeyPatch) -> None:
    solved = PccSimulator._run

    def gives_way(self: PccSimulator, *arguments: Any) -> Any:
        if len(arguments[-1][1][0]) > 0:
            raise SolverError("it does not bear this")
        return solved(self, *arguments)

    monkeypatch.setattr(PccSimulator, "_run", gives_way)
    problem = body_alone(body, 0.2)
    assert suited(problem, 1e-4).dt_s > problem.numerics.dt_s
