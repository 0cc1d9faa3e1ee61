"""The stage on a synthetic body: what it promises in its metrics and its artifact."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.config import build
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.tracking import NullTracker
from softrl.pod.stage import Config, run
from softrl.robots.robot import Robot
from tests.pod import synthetic
from tests.pod.synthetic import robot_with
from tests.pod.test_fit import Lopsided

CONF = Path(__file__).parents[2] / "conf"
Body = tuple[Robot, Snapshots, ReducedModel]


def config(**overrides: object) -> Config:
    """Return the tiny config."""
    quick, tiny = (yaml.safe_load((CONF / place / "pod.yaml").read_text()) for place in ("stage", "profile/tiny"))
    return build({**quick, **tiny, "seed": 3, **overrides}, Config, "stage")


def test_it_reduces_a_body_and_says_how_well(tripod: Body, tmp_path: Path) -> None:
    robot, snapshots, _ = tripod
    tracker = NullTracker()
    model = run(config(), robot, snapshots, tracker=tracker)
    metrics = tracker.metrics
    assert metrics["heldout/static_tip_rms_mm"] < 0.05 * metrics["heldout/baseline_linear_static_tip_rms_mm"]
    assert metrics["heldout/dynamic_tip_rms_mm"] < 0.2 * metrics["heldout/baseline_linear_dynamic_tip_rms_mm"]
    assert metrics["heldout/dynamic_tip_rms_mm"] < 0.2 * metrics["heldout/baseline_static_dynamic_tip_rms_mm"]
    assert metrics["heldout/pod_projection_rms_mm"] < 0.1 * metrics["heldout/baseline_no_modes_rms_mm"]
    assert metrics["rom_steps_failed"] == 0
    model.save(tmp_path / "model")
    again = ReducedModel.load(tmp_path / "model")
    np.testing.assert_array_equal(again.energy, model.energy)
    assert again.robot_name == robot.name


def test_a_body_that_no_energy_holds_is_linear(tripod: Body, caplog: pytest.LogCaptureFixture) -> None:
    """And told so once for the fit that is judged and once for that to all, not for those of the convergence figure."""
    robot, snapshots, _ = tripod
    tracker = NullTracker()
    model = run(config(ridges=[1e-6], image_weights=[0.1, 1.0], convergence_shares=[0.3, 1.0]), robot, snapshots, tracker=tracker)
    assert model.energy.shape == (1 + 6 + 21,)
    assert tracker.metrics["heldout/static_tip_rms_mm"] < tracker.metrics["heldout/motion_tip_rms_mm"]
    assert caplog.text.count("the reduced model is linear") == 2 and "smaller stage.ridges" in caplog.text


def test_a_lopsided_body_is_told_once_whoever_fits(
    tripod: Body, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(synthetic, "law_of", lambda robot: Lopsided(robot.chamber_direction))
    lopsided = synthetic.synthetic_snapshots(tripod[0], 20, seed=3, trajectories=0)
    run(config(convergence_shares=[0.5, 1.0]), tripod[0], lopsided, tracker=NullTracker())
    assert caplog.text.count("changes the body's mass at rest") == 1


def test_it_is_deterministic_and_does_without_trajectories(tripod: Body) -> None:
    robot, snapshots, _ = tripod
    still = replace(
        snapshots,
        trajectory_load=snapshots.trajectory_load[:0],
        trajectory_coordinate=snapshots.trajectory_coordinate[:0],
        trajectory_quaternion=snapshots.trajectory_quaternion[:0],
    )
    first, second = (run(config(), robot, still, tracker=NullTracker()) for _ in range(2))
    np.testing.assert_array_equal(first.energy, second.energy)
    np.testing.assert_array_equal(first.modes, second.modes)


def test_another_robots_snapshots_are_refused(tripod: Body) -> None:
    with pytest.raises(ArtifactError, match="3 chambers"):
        run(config(), robot_with(2), tripod[1], tracker=NullTracker())


def test_a_wrong_share_is_refused() -> None:
    with pytest.raises(ConfigError, match="heldout_share=2"):
        config(heldout_share=2.0)
