"""Figures say what was found: what is named is red, white noise stays in its band, a command has its own unit."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.config import build
from softrl.diagnosis.fitting.hypothesis import Choice, Gate
from softrl.diagnosis.judging.correct import Traces
from softrl.diagnosis.telling.figures import _autocorrelation, _white_band, draw_intervals, draw_map, draw_screening
from softrl.diagnosis.telling.report import page
from softrl.recordings.recording import Recording
from softrl.robots.robot import Robot
from tests.diagnosis.conftest import node


@pytest.mark.parametrize(
    ("named", "red"),
    [
        (Choice("dead_time", pinned=("dispersion",)), ["dead_time"]),
        (Choice("gain", 1, gate=Gate("since_s", 9.0)), ["gain (chamber 2, from a time on)"]),
        (Choice("gain", 1, gate=Gate("above_share", 0.4)), ["gain (chamber 2)", "gain (chamber 2, from a time on)"]),
        (Choice("gain", 1, sessions=("monday",)), []),
        (Choice("lag", behind_gauge=True), []),
    ],
)
def test_what_is_named_is_red_in_the_screening_though_it_was_slimmed_or_gated(named: Choice, red: list[str]) -> None:
    begun = Choice("gain", 1, gate=Gate("since_s", 5.0))
    choices = [Choice("dead_time"), Choice("gain", 1), begun, Choice("gain"), Choice("lag")]
    problem = SimpleNamespace(target="motion", robot=SimpleNamespace(output="tip_position"))
    finding: Any = SimpleNamespace(
        path=SimpleNamespace(screened=[[SimpleNamespace(choice=choice, gain=0.1) for choice in choices]]),
        named=[SimpleNamespace(choice=named)],
        judge=SimpleNamespace(rms=lambda squares: 1e-3),
        base=SimpleNamespace(squares=None),
        part=SimpleNamespace(title="command to motion", problem=problem),
    )
    axis = draw_screening([finding]).axes[0]
    labels = [label.get_text() for label in axis.get_yticklabels()]
    drawn = [label for label, bar in zip(labels, axis.patches, strict=True) if bar.get_facecolor()[0] > 0.7]  # type: ignore[attr-defined]
    assert drawn == red


@pytest.mark.parametrize("mix", [np.eye(3), np.diag([1.0, 0.1, 0.1]), np.ones((3, 3)) + 0.3 * np.eye(3), np.eye(1)])
def test_as_many_autocorrelations_of_white_noise_lie_in_the_band_as_it_says(mix: np.ndarray) -> None:
    rng, outside = np.random.default_rng(0), []
    for _ in range(100):
        runs = [rng.standard_normal((190, len(mix))) @ mix for _ in range(2)]
        outside.append(np.abs(_autocorrelation(runs, 20)[1:]) > _white_band(runs))
    assert 0.03 < np.mean(outside) < 0.07


@pytest.mark.parametrize(("name", "scale", "unit"), [("single_chamber_finger", 0.01, "pump_pwm"), ("tripod", 1e-3, "kPa")])
def test_the_map_of_errors_shows_commands_in_their_own_unit(name: str, scale: float, unit: str) -> None:
    robot = build(node(f"robot/{name}.yaml"), Robot, "robot")
    time = 0.1 * np.arange(1, 101)
    pressure = 2e4 * np.sin(time)[:, None] * np.eye(1, robot.chambers)
    run = Recording("a", "monday", time, pressure, bend_angle=np.zeros(100), position=np.zeros((100, 3)))
    heldout: Any = SimpleNamespace(robot=robot, runs=[run], first=[0])
    shape = (100, 1) if robot.output == "bend_angle" else (100, 3)
    traces = Traces([np.ones(shape)], 1.0)
    axes = draw_map(heldout, {"retuned": traces, "corrected": traces}).axes
    assert axes[0].get_ylabel() == f"command of chamber 1, {unit}" and axes[2].get_xlabel() == f"rate of the command, {unit}/s"
    assert axes[0].get_ylim()[1] == pytest.approx(scale * 2e4, rel=0.01)


@pytest.mark.parametrize("pct", [90.0, 98.0])
def test_intervals_say_of_which_level_they_are(pct: float) -> None:
    fill = {"value": 0.3, "low": 0.2, "high": 0.4, "unit": "s", "at_bound": False}
    named = {"name": "lag", "where": "all valves", "parameters": {"fill_s": fill}}
    data = {"warnings": [], "interval_pct": pct}
    found = Diagnosis("tripod", "PccSimulator", "named", ["so"], [named], {}, {}, [], [], {}, {}, {}, None, data)
    assert draw_intervals(found).get_supxlabel() == f"bars: {pct:g} % intervals"
    assert f"<h2>Identified parameters and their {pct:g} % intervals</h2>" in page(found, {})
    assert "intervals" not in page(replace(found, verdict="unknown", effects=[], data={"warnings": []}), {})
