"""Tests of where simulation and measurement part."""

from dataclasses import replace

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.problem import Problem
from softrl.diagnosis.judging.locate import _regressors, locate
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made


def test_where_nothing_is_left_nothing_is_told_and_every_number_is_one(body: PccSimulator) -> None:
    """Recordings that the simulator made itself, without noise."""
    runs = made(body, sessions=3, noise_m=0.0).recordings
    problem = Problem(body.robot, body, runs, configured().numerics, "motion", "command", False, False)
    residual = problem.residual(Hypothesis((), ()), np.zeros(0))
    assert not residual.flat.any()
    found = locate(problem, residual, 0.0, "command to motion")
    assert all(np.isfinite(row.effect_size) and row.p_value == 1.0 for row in found)
    assert any(row.region == "band" for row in found)


def test_a_run_of_one_bin_takes_no_part_in_what_needs_a_course(body: PccSimulator) -> None:
    """A table of poses may hold a run of two rows, of which the first is not judged where it does not begin at rest."""
    runs = made(body, sessions=3).recordings
    short = replace(runs[0], **runs[0].part([300, 400]))
    found = []
    for some in (runs, (*runs, replace(short, name="short"))):
        problem = Problem(body.robot, body, tuple(some), configured().numerics, "motion", "command", False, False)
        found.append(locate(problem, problem.residual(Hypothesis((), ()), np.zeros(0)), 0.0, "command to motion"))
    assert len(problem.bins[-1]) == 1
    whole, beside = ({(row.chamber, row.region) for row in rows if row.region != "band"} for rows in found)
    assert whole == beside


def test_suction_is_looked_at_as_pressure_is(body: PccSimulator) -> None:
    """Its largest values, new ones of them, and what is above most: of a robot that sucks they are the least pressures."""
    found, recorded = [], made(body, sessions=2).recordings
    for way in (1.0, -1.0):
        runs = tuple(replace(run, pressure_cmd=way * np.maximum(run.pressure_cmd, 0.0)) for run in recorded)
        problem = Problem(body.robot, body, runs, configured().numerics, "motion", "command", False, False)
        found.append({key: series for key, series in _regressors(problem).items() if key[0] is not None})
    pressed, sucked = found
    assert pressed.keys() == sucked.keys() and any(region == "above high pressure" for _, region in pressed)
    for key, series in pressed.items():
        for one, other in zip(series, sucked[key], strict=True):
            np.testing.assert_allclose(one, other, atol=1e-12, err_msg=str(key))
