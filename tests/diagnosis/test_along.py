"""Markers tell which piece of the body bends otherwise than simulated."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.core.config import build
from softrl.diagnosis.along import along_the_body
from softrl.diagnosis.hypothesis import Hypothesis
from softrl.diagnosis.problem import Numerics, Problem
from softrl.diagnosis.search import Fit
from softrl.diagnosis.trial import Trial
from softrl.effects.chain import Plant, chain_of
from softrl.effects.replay import replay
from softrl.pcc.simulator import PccSimulator
from softrl.recordings.recording import Recording
from tests.diagnosis.conftest import node, programs

BARE = Trial(Hypothesis((), ()), Fit(np.zeros(0), np.zeros(0), np.zeros((0, 0)), 0.0, 0), {}, np.zeros(0), np.zeros(0))
PIECES = ("the base and marker1", "marker1 .* and marker2", "marker2 .* and the tip")
SHARES = np.array([1 / 3, 2 / 3, 1.0])
OFFSET = np.array([0.03, -0.01, 0.0])


def bent(quaternion: np.ndarray, ends: np.ndarray, length: np.ndarray, softer: np.ndarray) -> list[np.ndarray]:
    """Return the points (steps, 3) at ``ends`` of a chain of 300 links, ``length`` (steps,), bent ``softer`` (pieces,) times."""
    half = np.arctan2(np.linalg.norm(quaternion[:, 1:], axis=1), quaternion[:, 0])
    axis = quaternion[:, 1:] / np.maximum(np.sin(half), 1e-12)[:, None]
    s = (np.arange(300) + 0.5) / 300
    curvature = softer[np.searchsorted(SHARES, s)]
    turned = np.cumsum(curvature) / 300 - 0.5 * curvature / 300
    point, found = np.zeros((len(half), 3)), []
    direction = np.stack([axis[:, 1], -axis[:, 0], np.zeros(len(half))], axis=1)
    for k, t in enumerate(turned):
        angle = 2.0 * half * t
        point = point + length[:, None] / 300 * (np.sin(angle)[:, None] * direction + np.cos(angle)[:, None] * [0.0, 0.0, 1.0])
        if np.isclose(ends, (k + 1) / 300).any():
            beside = np.sum(OFFSET * direction, axis=1)[:, None]
            tilted = OFFSET + beside * ((np.cos(angle)[:, None] - 1.0) * direction - np.sin(angle)[:, None] * [0, 0, 1.0])
            found.append(point + (0.0 if np.isclose(ends[-1], (k + 1) / 300) else tilted))
    return found


def recorded(body: PccSimulator, softer: list[float], seed: int = 1) -> Problem:
    rng, runs = np.random.default_rng(seed), []
    for number in range(2):
        time, pressure = programs(body.robot, rng, 0.02)
        pressure[:25] = 0.0
        made = replay(Plant(body, chain_of(body.robot, ())), Recording(f"run{number}", "day", time, pressure), 0.01)
        quaternion, unit = np.asarray(made.quaternion), np.ones(len(time))
        straight = bent(quaternion, SHARES, unit, np.ones(3))[-1]
        length = np.linalg.norm(np.asarray(made.position), axis=1) / np.linalg.norm(straight, axis=1)
        low, high, tip = bent(quaternion, SHARES, length, np.array(softer))
        noise = 2e-4 * rng.standard_normal((3, len(time), 3))
        markers = {"marker1": low + noise[0], "marker2": high + noise[1]}
        runs.append(replace(made, position=tip + noise[2], markers=markers))
    numerics = build(node("stage/diagnosis.yaml")["numerics"], Numerics, "numerics")
    return Problem(body.robot, body, tuple(runs), numerics, "motion", "command", False, False)


@pytest.mark.parametrize("piece", [0, 1, 2])
@pytest.mark.parametrize("factor", [1.3, 0.7])
def test_the_piece_that_bends_otherwise_is_found(body: PccSimulator, piece: int, factor: float) -> None:
    softer = [1.0, 1.0, 1.0]
    softer[piece] = factor
    found = along_the_body(recorded(body, softer), BARE, "motion")
    assert len(found) == 3
    assert found[piece].effect_size > 0.6 and found[piece].p_value < 1e-6, found
    assert ("more" if factor > 1.0 else "less") in str(found[piece].region)


def test_without_a_mismatch_no_piece_follows_the_pressures(body: PccSimulator) -> None:
    still = replace(body.robot, gravity_m_s2=(0.0, 0.0, 0.0))  # in weight an arc's tip turns otherwise than it moves
    found = along_the_body(recorded(replace(body, robot=still), [1.0, 1.0, 1.0]), BARE, "motion")
    assert min(f.p_value for f in found) > 1e-3, found


def test_markers_at_the_tip_or_missing_in_a_run_say_nothing(body: PccSimulator) -> None:
    problem = recorded(body, [1.0, 1.0, 1.0])
    first, second = problem.runs
    assert along_the_body(problem.on([replace(first, markers={}), second]), BARE, "motion") == []
    at_tip = [replace(run, markers={"marker9": np.asarray(run.position)}) for run in problem.runs]
    assert along_the_body(problem.on(at_tip), BARE, "motion") == []
