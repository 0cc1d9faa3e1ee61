"""A path of equilibria is continuous: what only a jump reaches is missed, with the place; a smooth path costs nothing."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrl.artifacts.mesh import Mesh
from softrl.core.errors import SolverError
from softrl.core.tracking import NullTracker
from softrl.fem.continuation import Equilibrium, Missed, follow
from softrl.fem.model import FemModel
from softrl.fem.newton import NewtonSettings
from softrl.fem.sampling import load_scale, sobol_loads
from softrl.fem.stage import run
from tests.fem.bodies import arch, box_robot, hollow_box, model_of
from tests.fem.test_stage import CONFIG

SCALE = np.array([1e4, 1.0, 1.0, 2e-3])  # of an arch's loads: Pa and N


def push(model: FemModel, forces_n: np.ndarray) -> list[Equilibrium | Missed]:
    """Return what becomes of an arch under a force downward on its ridge."""
    loads = np.zeros((len(forces_n), 4))
    loads[:, 3] = -forces_n
    return list(follow(model, loads, SCALE, 0.8))


def test_an_arch_is_followed_up_to_where_it_snaps_and_not_beyond() -> None:
    model, forces = model_of(arch(0.004)), np.array([1e-3, 2e-3, 3e-3, 5e-3, 6e-3])
    ends = push(model, forces)
    assert [isinstance(end, Missed) for end in ends] == [False, False, False, True, True]
    assert all("jumps" in end.reason and " mm moves " in end.reason for end in ends if isinstance(end, Missed))
    # the limit point is a property of the arch: both loads stop at the same force
    limits = [f * float(end.reason.split("between ")[1].split("%")[0]) / 100 for f, end in zip(forces[3:], ends[3:])]
    assert limits[0] == pytest.approx(limits[1], rel=0.03)
    beyond = model.static(np.array([0.0, 0.0, 0.0, -5e-3]))
    assert beyond.converged and beyond.stable  # Newton alone ends on the other branch, content
    assert model.coordinate(beyond.pose)[3] < -0.004


def test_unloaded_from_beyond_its_snap_the_arch_has_two_equilibria() -> None:
    model = model_of(arch(0.004))
    load = np.array([0.0, 0.0, 0.0, -2e-3])
    beyond = model.static(load, model.static(3 * load).pose)
    (end,) = push(model, np.array([2e-3]))
    assert isinstance(end, Equilibrium)
    assert beyond.converged and beyond.stable
    assert model.coordinate(beyond.pose)[3] < model.coordinate(end.pose)[3] - 0.004


@pytest.mark.parametrize("rise", [0.0, 0.001])
def test_a_strip_that_stiffens_or_softens_fast_but_smoothly_is_followed(rise: float) -> None:
    model = model_of(arch(rise))
    ends = push(model, np.array([1e-3, 2e-3, 8e-3]))
    assert all(isinstance(end, Equilibrium) for end in ends)
    compliance = np.array([end.tangent.compliance[3, 3] for end in ends if isinstance(end, Equilibrium)])
    assert (np.diff(compliance) < 0).all()


def test_a_smooth_path_takes_no_more_factorisations_than_newton_from_prediction_to_prediction(box: Mesh) -> None:
    model, robot = model_of(box), box_robot(2)
    loads, scale = sobol_loads(robot, 6, 0.25, np.zeros(3), 0), load_scale(robot)
    before, pose = np.zeros(5), model.rest()
    for load, end in zip(loads, follow(model, loads, scale, 0.8), strict=True):
        assert isinstance(end, Equilibrium) and end.cost.halvings == 0
        plain = model_of(box)
        rate = plain.tangent(pose, before).change
        count, factorisations = max(1, int(np.ceil(np.linalg.norm((load - before) / scale) / 0.8))), 1
        part = (load - before) / count
        for step in range(1, count + 1):
            guess = plain.coupling.move(pose, rate @ part)
            solve = plain.static(before + step * part, guess)
            pose, factorisations = solve.pose, factorisations + solve.factorisations
            rate = plain.solve(plain.load_directions(pose))
        assert end.cost.factorisations == factorisations
        before = load


def test_a_box_that_buckles_under_vacuum_is_missed_with_the_place_and_one_that_shrinks_is_not() -> None:
    vacuum, scale = np.array([[-1.5e5, 0.0, 0.0, 0.0]]), np.array([1e5, 1.0, 1.0, 1.0])
    thin, wide = (model_of(hollow_box(5, width), newton=NewtonSettings(1e-7, 40, 0.3)) for width in (0.03, 0.05))
    (buckled,), (shrunk,) = (list(follow(model, vacuum, scale, 0.8)) for model in (thin, wide))
    assert isinstance(buckled, Missed) and buckled.jumped
    assert "of the way from load [0. 0. 0. 0.]" in buckled.reason
    assert isinstance(shrunk, Equilibrium)


def test_a_missed_load_is_told_in_one_line_however_many_chambers_there_are(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    model, load = model_of(hollow_box(chambers=4)), np.array([1e4, -1e4, 2e4, 1e3, 0.1, 0.2, 0.3]) / 3.0
    static = model.static  # finds the rest, and nothing from there
    monkeypatch.setattr(model, "static", lambda to, *start: static(to, *start[:1], most_factors=0 if start else None))
    (missed,) = follow(model, load[None], np.r_[np.full(4, 1e4), np.ones(3)], 0.8)
    assert isinstance(missed, Missed)
    (line,) = caplog.messages
    assert "no equilibrium at load [" in line and "\n" not in line


def test_the_stage_records_jumps_with_their_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    texts: dict[str, str] = {}

    class Keeper(NullTracker):
        def text(self, name: str, content: str) -> None:
            texts[name] = content

    robot = replace(box_robot(1), pressure_min_pa=-0.1, pressure_max_pa=0.1, tip_force_max_n=8e-3)
    config = replace(
        CONFIG, equilibria=6, faces_share=0.0, trajectories=0, max_failed_share=1.0, paths=1, load_step=0.4, max_iterations=200
    )
    tracker = Keeper()
    snapshots = run(config, robot, arch(0.004), tracker=tracker)
    rows = list(csv.DictReader(texts["failed_loads.csv"].splitlines()))
    assert len(rows) == snapshots.failed == tracker.metrics["failed"] > 0
    assert snapshots.failed + len(snapshots.loads) >= 6
    assert tracker.metrics["jumps"] == sum("jumps" in row["reason"] for row in rows) > 0
    kept = {tuple(load.round(9)) for load in snapshots.loads}
    names = ("p1_pa", "force_x_n", "force_y_n", "force_z_n")
    assert not kept & {tuple(round(float(row[name]), 9) for name in names) for row in rows}
    with pytest.raises(SolverError, match=r"behind a jump.*sample .*of the way from load.*narrow the robot's"):
        run(replace(config, max_failed_share=0.0), robot, arch(0.004), tracker=NullTracker())
