"""The stage: what it hands on, and that it is the same however it is run."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from softrl.artifacts.mesh import Mesh
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ConfigError, SolverError
from softrl.core.tracking import NullTracker
from softrl.fem import stage
from softrl.fem.chain import Chain
from softrl.fem.material import StableNeoHookean
from softrl.fem.model import FemModel
from softrl.fem.stage import Body, Config, build_model, run
from tests.fem.bodies import assert_same, box_robot

CONF = Path(__file__).resolve().parents[2] / "conf"
CONFIG = Config(
    law="stable_neo_hookean",
    moduli_pa=(1e6,),
    poisson=0.45,
    element_order=2,
    mean_dilatation=True,
    equilibria=5,
    faces_share=0.2,
    tip_force_scale=1.0,
    weight_share=0.0,
    load_step=4.0,
    paths=2,
    trajectories=1,
    duration_s=0.02,
    hold_s=0.01,
    dt_s=0.002,
    rayleigh_mass_per_s=0.0,
    rayleigh_stiffness_s=1e-3,
    tolerance_m=1e-8,
    max_iterations=40,
    reuse_below=0.3,
    max_failed_share=0.0,
    processes=1,
    seed=0,
)


@pytest.fixture(scope="module")
def tracker() -> NullTracker:
    return NullTracker()


@pytest.fixture(scope="module")
def snapshots(box: Mesh, tracker: NullTracker) -> Snapshots:
    return run(CONFIG, box_robot(2), box, tracker=tracker)


def test_every_sample_is_an_equilibrium_of_its_load(box: Mesh, snapshots: Snapshots) -> None:
    snapshots.validate()
    model = build_model(Body(CONFIG, box_robot(2), box, StableNeoHookean(1e6, 0.45)))
    for row in range(len(snapshots.loads)):
        solve = model.static(snapshots.loads[row])
        assert np.allclose(model.coordinate(solve.pose)[2:], snapshots.coordinate[row, 2:], atol=1e-8)
        assert np.allclose(model.coordinate(solve.pose)[:2], snapshots.coordinate[row, :2], rtol=1e-4, atol=1e-12)
        moved = (solve.pose.position - model.solid.points)[: len(box.points)]
        assert np.abs(moved - snapshots.displacement[row]).max() < 1e-7
        assert snapshots.energy[row] == pytest.approx(model.elastic_energy(solve.pose), rel=1e-4)


def test_compliance_is_symmetric_and_the_masses_add_up(box: Mesh, snapshots: Snapshots) -> None:
    assert (snapshots.compliance == np.swapaxes(snapshots.compliance, 1, 2)).all()
    assert np.linalg.eigvalsh(snapshots.compliance).min() > 0
    assert np.linalg.eigvalsh(snapshots.tangent_mass).min() > 0
    assert snapshots.nodal_mass.sum() == pytest.approx(snapshots.mass)
    assert snapshots.mass == pytest.approx(0.04)
    assert np.abs(np.linalg.norm(snapshots.tip_quaternion, axis=1) - 1).max() < 1e-12


def test_centre_of_mass_moves_as_the_corner_masses_say(snapshots: Snapshots) -> None:
    # corners carry half of each mid-edge node; curved edges make the difference
    moved = np.einsum("n,sni->si", snapshots.nodal_mass, snapshots.displacement.astype(float)) / snapshots.mass
    centre = snapshots.moments[:, 0] / snapshots.mass
    assert np.abs(moved - centre).max() < 0.05 * np.abs(centre).max()


def test_processes_do_not_change_the_result(box: Mesh, snapshots: Snapshots) -> None:
    again = run(replace(CONFIG, processes=2), box_robot(2), box, tracker=NullTracker())
    assert_same(snapshots, again)


def test_how_long_many_equilibria_take_is_said_before_the_first_part(
    box: Mesh, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(stage, "FORETOLD", 1)
    with caplog.at_level(logging.INFO):
        run(CONFIG, box_robot(2), box, tracker=NullTracker())
    lines = [record.getMessage() for record in caplog.records]
    said = next(k for k, line in enumerate(lines) if "equilibria at" in line and "min in 1 processes" in line)
    assert said < next(k for k, line in enumerate(lines) if "equilibria and" in line), lines


def test_metrics_are_reported(tracker: NullTracker, snapshots: Snapshots) -> None:
    names = {"equilibria", "failed", "newton_iterations_mean", "seconds_per_equilibrium_s", "tip_range_mm"}
    assert names <= set(tracker.metrics)
    assert tracker.metrics["equilibria"] == len(snapshots.loads) == 6  # five, and a corner


def test_failures_are_counted_and_too_many_are_an_error(box: Mesh) -> None:
    with pytest.raises(SolverError, match="of 6 loads found no equilibrium"):
        hopeless = replace(CONFIG, max_iterations=1, tolerance_m=1e-14, trajectories=0)
        run(hopeless, box_robot(2), box, tracker=NullTracker())


def test_a_robot_made_for_little_force_needs_no_more_equilibria(box: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    # half its weight is most of a load's way there, and no longer a way than of other robots
    counts = []

    def trace(model: FemModel, loads: np.ndarray, *rest: object) -> Chain:
        counts.append(len(loads))
        raise SolverError("enough")

    monkeypatch.setattr(stage, "trace", trace)
    config = replace(CONFIG, weight_share=0.5, load_step=0.8, trajectories=0)
    for most in (0.5, 0.05, 1e-3, 1e-5):
        with pytest.raises(SolverError, match="enough"):
            run(config, replace(box_robot(2), tip_force_max_n=most), box, tracker=NullTracker())
    assert max(counts) <= 1.5 * counts[0]


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"stage\.dt_s"):
        replace(CONFIG, dt_s=0.0)
    with pytest.raises(ConfigError, match=r"stage\.faces_share"):
        replace(CONFIG, faces_share=1.5)
    for duration_s in (CONFIG.dt_s, 0.1 * CONFIG.dt_s):
        with pytest.raises(ConfigError, match=r"stage\.duration_s=.* steps of stage\.dt_s=0\.002; expected two or more"):
            replace(CONFIG, duration_s=duration_s)
        assert replace(CONFIG, duration_s=duration_s, trajectories=0).steps < 2


def test_the_stage_samples_the_body_that_the_simulator_steps() -> None:
    stage, simulator = (OmegaConf.load(CONF / name / "fem.yaml") for name in ("stage", "simulator"))
    for key in ("law", "moduli_pa", "poisson", "element_order", "mean_dilatation", "rayleigh_stiffness_s"):
        assert stage[key] == simulator[key], key


def test_order_and_dilatation_reach_the_model(box: Mesh) -> None:
    material, robot = StableNeoHookean(1e6, 0.45), box_robot(2)
    linear = build_model(Body(replace(CONFIG, element_order=1), robot, box, material))
    pointwise = build_model(Body(replace(CONFIG, mean_dilatation=False), robot, box, material))
    mean = build_model(Body(CONFIG, robot, box, material))
    load = np.array([8e3, 0.0, 0.1, 0.0, 0.0])
    work = [load @ m.coordinate(m.static(load).pose) for m in (linear, pointwise, mean)]
    assert linear.solid.elements.shape[1] == 4
    assert work[0] < work[1] < work[2]  # each freedom given softens the body
    with pytest.raises(ConfigError, match=r"stage\.element_order=3"):
        replace(CONFIG, element_order=3)
