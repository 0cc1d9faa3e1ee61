"""Benches are right about what they compare; how fast they find this machine is not a test."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softrl.bench.fem import FemBench
from softrl.bench.reference import Reference
from softrl.bench.stage import Config, run
from softrl.bench.watch import Timing, Watch, machine, peak_memory_gb
from softrl.core.config import build
from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from tests.bench.full import full_simulator
from tests.fem.bodies import NEWTON, box_robot, hollow_box, model_of

BOX = hollow_box(chambers=2)
SIMULATOR = full_simulator(
    box_robot(2), BOX, rayleigh_mass_per_s=1.0, rayleigh_stiffness_s=0.01, tolerance_m=1e-9
)
BENCH = FemBench(SIMULATOR, 5e3, 0.005, 1, (), 1, ())


def test_the_reference_makes_the_same_step() -> None:
    pytest.importorskip("skfem")
    model = model_of(BOX, rayleigh_mass_per_s=2.0, rayleigh_stiffness_s=0.01, gravity_m_s2=(0.0, 1.0, -9.81), newton=NEWTON)
    load, state = np.array([6e3, -2e3, 0.2, 0.1, -0.3]), model.state()
    for _ in range(2):
        state = model.step(state, load, 0.004).state
    reference = Reference(model)
    forces = model._elastic(state.pose, 1).gradient
    assert np.abs(reference.force(state.pose.position) - forces).max() < 1e-9 * np.abs(forces).max()
    ours, theirs = model.step(state, load, 0.004).state.pose, reference.step(state, load, 0.004)
    moved = np.abs(ours.position - state.pose.position).max()
    assert np.abs(ours.position - theirs.pose.position).max() < 1e-5 * moved
    assert theirs.iterations <= 6, "a wrong matrix would converge slowly"


@pytest.mark.parametrize("changed", [{"element_order": 1}, {"youngs_modulus_scale": 2.0}, {"law": "corotational"}])
def test_where_the_reference_is_of_another_body_there_is_none(
    changed: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    other = replace(BENCH, simulator=replace(SIMULATOR, **changed))
    assert other.against_reference(Watch(1)) == {}
    assert "no scikit-fem reference" in caplog.text


def test_the_stage_reports_what_it_promises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("skfem")
    tracker = NullTracker()
    small = replace(SIMULATOR, robot=box_robot(1), mesh=hollow_box())
    finer = replace(BENCH, simulator=small, mesh_parts=(2,), convergence_parts=(1, 2, 3))
    made = run(Config(1, "cpu", 0), small.robot, {"fem": finer}, tracker=tracker)
    promised = {"assembly_ms", "factor_solve_ms", "step_ms", "steps_per_s", "speedup_vs_scikit_fem",
                "convergence_error_pct", "peak_memory_gb"}  # fmt: skip
    assert promised <= set(tracker.metrics) and all(np.isfinite(list(tracker.metrics.values())))
    assert tracker.metrics["scikit_fem_node_difference_mm"] < 1e-4
    assert 0.0 < tracker.metrics["convergence_error_pct"] < 50.0
    assert made.document()["machine"]["cores"] >= 1
    made.save(tmp_path / "benchmark")
    assert type(made).load(tmp_path / "benchmark") == made


def test_timings_are_medians_and_take_turns() -> None:
    seen: list[str] = []
    first, second = Watch(3).time(lambda: seen.append("a"), lambda: seen.append("b"))
    assert "".join(seen) == "ababab" and first.minimum <= first.median <= first.maximum
    assert Timing(1.0, 2.0, 4.0).rate("x", 8.0) == {"x_per_s": 4.0, "x_min_per_s": 2.0, "x_max_per_s": 8.0}
    assert 0.01 < peak_memory_gb() < 100 and machine()["python"]


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"bench\.fem\.dt_s"):
        replace(BENCH, dt_s=0.0)
    for parts in ((2, 3, 4), (1, 3, 2), (1, 2, 2)):
        with pytest.raises(ConfigError, match=r"convergence_parts"):
            replace(BENCH, convergence_parts=parts)
    with pytest.raises(ConfigError, match=r"stage\.clock=sun"):
        build({"repeats": 1, "clock": "sun", "seed": 0}, Config, "stage")
