"""Markers tell which piece of the body bends otherwise than simulated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrl.core.config import build
from softrl.diagnosis.fitting.hypothesis import Hypothesis
from softrl.diagnosis.fitting.minimise import Fit
from softrl.diagnosis.fitting.problem import Numerics, Problem
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.judging.along import along_the_body
from softrl.effects.chain import Plant, chain_of
from softrl.effects.replay import replay
from softrl.pcc.model import fill_shape
from softrl.pcc.simulator import PccSimulator, PccState
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import node, programs

BARE = Trial(Hypothesis((), ()), Fit(np.zeros(0), np.zeros(0), np.zeros((0, 0)), 0.0, 0), {}, np.zeros(0), np.zeros(0))
PIECES = ("the base and marker1", "marker1 .* and marker2", "marker2 .* and the tip")
SHARES = np.array([1 / 3, 2 / 3, 1.0])
OFFSET = np.array([0.03, -0.01, 0.0])


def bent(shape: np.ndarray, length_m: float, softer: np.ndarray) -> list[np.ndarray]:
    """Return the points (steps, 3) at ``SHARES`` of a chain of 300 links, each piece bent ``softer`` times as its ``shape``.

    ``shape`` (steps, 5) is bends, elongation and loss of curvature; markers below the tip sit beside the chain.
    """
    s = (np.arange(300) + 0.5) / 300
    curvature = shape[:, None, :2] + (1.0 - 2.0 * s)[:, None] * shape[:, None, 3:]
    turning = curvature * softer[np.searchsorted(SHARES, s)][:, None] / 300
    lean = np.cumsum(turning, axis=1) - 0.5 * turning
    turned = Rotation.from_rotvec(np.dstack([-lean[..., 1], lean[..., 0], np.zeros_like(lean[..., 0])]).reshape(-1, 3))
    links = (length_m * (1.0 + shape[:, 2:3, None]) / 300) * turned.apply([0.0, 0.0, 1.0]).reshape(-1, 300, 3)
    beside, points = turned.apply(OFFSET).reshape(-1, 300, 3), np.cumsum(links, axis=1)
    return [points[:, end] + (0.0 if end == 299 else beside[:, end]) for end in (99, 199, 299)]


def recorded(body: PccSimulator, softer: list[float], seed: int = 1, count: int = 2) -> Problem:
    rng, runs = np.random.default_rng(seed), []
    for number in range(count):
        time, pressure = programs(body.robot, rng, 0.02)
        pressure[:25] = 0.0
        made = replay(Plant(body, chain_of(body.robot, ())), Recording(f"run{number}", "day", time, pressure), 0.01)
        shapes, state = [], body.reset()
        for row in pressure:  # acts until its own time
            state = body.step(state, np.tile(row, (2, 1)), 0.01)
            shapes.append(shape_of(body, state))
        straight = bent(np.array(shapes), body.robot.length_m, np.ones(3))[-1]
        np.testing.assert_allclose(straight, made.position, atol=1e-4)
        low, high, tip = bent(np.array(shapes), body.robot.length_m, np.array(softer))
        noise = 2e-4 * rng.standard_normal((3, len(time), 3))
        markers = {"marker1": low + noise[0], "marker2": high + noise[1]}
        runs.append(replace(made, position=tip + noise[2], markers=markers))
    numerics = build(node("stage/diagnosis.yaml")["numerics"], Numerics, "numerics")
    return Problem(body.robot, body, tuple(runs), numerics, "motion", "command", False, False)


def shape_of(body: PccSimulator, state: PccState) -> np.ndarray:
    """Return bends, elongation and loss of curvature (5,)."""
    shape = np.empty(5)
    fill_shape(body._model, state.coordinates, shape)
    return shape


@pytest.mark.parametrize("piece", [0, 1, 2])
@pytest.mark.parametrize("factor", [1.3, 0.7])
def test_the_piece_that_bends_otherwise_is_found(body: PccSimulator, piece: int, factor: float) -> None:
    softer = [1.0, 1.0, 1.0]
    softer[piece] = factor
    found = along_the_body(recorded(body, softer, count=3), BARE, "motion")
    assert len(found) == 3
    assert found[piece].effect_size > 0.6 and found[piece].p_value < 1e-6, found
    assert ("more" if factor > 1.0 else "less") in str(found[piece].region)


def test_without_a_mismatch_no_piece_follows_the_pressures(body: PccSimulator) -> None:
    found = along_the_body(recorded(body, [1.0, 1.0, 1.0]), BARE, "motion")
    assert min(f.p_value for f in found) > 1e-3, found


def test_markers_at_the_tip_or_missing_in_a_run_say_nothing(body: PccSimulator) -> None:
    problem = recorded(body, [1.0, 1.0, 1.0])
    first, second = problem.runs
    assert along_the_body(problem.on([replace(first, markers={}), second]), BARE, "motion") == []
    at_tip = [replace(run, markers={"marker9": np.asarray(run.position)}) for run in problem.runs]
    assert along_the_body(problem.on(at_tip), BARE, "motion") == []
