"""What the stage tells of its result is told of what there is."""

from types import SimpleNamespace

import numpy as np
import pytest

from softrl.artifacts.surrogate import Surrogate
from softrl.core.tracking import NullTracker
from softrl.robots.robot import Robot
from softrl.surrogate.report import report_full_model
from tests.surrogate.conftest import SOFTNESS_M_PER_N, lumped_body


def compared(robot: Robot, surrogate: Surrogate, force: np.ndarray) -> NullTracker:
    """Return what is told of equilibria of the lumped body under ``force`` (S, 3) N and a few pressures."""
    loads = np.hstack([np.resize(surrogate.sample_pressure, (len(force), surrogate.chambers)), force])
    compliance = np.zeros((len(force), 6, 6))
    compliance[:, 3:, 3:] = np.diag(SOFTNESS_M_PER_N)
    moved = np.hstack([np.zeros((len(force), 3)), lumped_body(robot)(loads).tip])
    snapshots = SimpleNamespace(loads=loads, coordinate=moved, compliance=compliance, rest_tip=np.zeros(3))
    tracker = NullTracker()
    report_full_model(surrogate, snapshots, lumped_body(robot), robot.tip_force_max_n, tracker)  # type: ignore[arg-type]
    return tracker


def test_loads_under_which_the_chain_buckles_are_left_out_of_the_comparison(
    robot: Robot, surrogate: Surrogate, caplog: pytest.LogCaptureFixture
) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.5, (12, 3))
    expected = compared(robot, surrogate, force).metrics
    assert "buckles" not in caplog.text
    found = compared(robot, surrogate, np.vstack([force, [[0.0, 0.0, -800.0]]])).metrics
    assert "the chain buckles under 1 of 13 loads of the full model" in caplog.text
    del expected["full_model/unloaded_tip_mm"], found["full_model/unloaded_tip_mm"]
    assert found == expected and expected["full_model/loaded_count"] == 12
