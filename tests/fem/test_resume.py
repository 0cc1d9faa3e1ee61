"""A killed run of the stage goes on where it was, and ends with the same artifact."""

import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softrl.artifacts.mesh import Mesh
from softrl.core.errors import SolverError
from softrl.core.resume import Kept
from softrl.core.tracking import NullTracker
from softrl.fem.material import StableNeoHookean
from softrl.fem.stage import Body, _mark, run
from tests.fem.bodies import assert_same, box_robot, hollow_box
from tests.fem.test_stage import CONFIG

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = replace(CONFIG, equilibria=3, paths=2, trajectories=1)


def run_and_die() -> None:
    """Run the stage in this process, which is killed when the second part has been kept."""
    save = Kept.save

    def save_or_die(self: Kept, name: str, arrays: dict[str, np.ndarray]) -> None:
        save(self, name, arrays)
        if len(list(self.folder.glob("*.npz"))) == 2:
            os.kill(os.getpid(), signal.SIGKILL)

    Kept.save = save_or_die  # type: ignore[method-assign]
    run(SETTINGS, box_robot(2), hollow_box(chambers=2), tracker=NullTracker())


def test_a_killed_run_goes_on(tmp_path: Path, box: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    script = "from tests.fem.test_resume import run_and_die; run_and_die()"
    killed = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.rglob("*.npz"))) == 2

    resumed, whole = NullTracker(), NullTracker()
    again = run(SETTINGS, box_robot(2), box, tracker=resumed)
    assert resumed.metrics["parts_resumed"] == 2
    assert list(tmp_path.iterdir()) == [], "kept parts are removed when the stage ends"

    plain = run(SETTINGS, box_robot(2), box, tracker=whole)
    assert whole.metrics["parts_resumed"] == 0
    assert_same(again, plain)


def test_other_settings_do_not_meet_kept_parts(box: Mesh) -> None:
    body = Body(SETTINGS, box_robot(2), box, StableNeoHookean(1e6, 0.45))
    same = body._replace(config=replace(SETTINGS, processes=7))
    moved = body._replace(mesh=replace(box, points=box.points * 1.001))
    assert _mark(body) == _mark(same)
    assert len({_mark(body), _mark(moved), _mark(body._replace(config=replace(SETTINGS, seed=1)))}) == 3


def test_loads_that_fail_are_recorded(box: Mesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    texts: dict[str, str] = {}

    class Keeper(NullTracker):
        def text(self, name: str, content: str) -> None:
            texts[name] = content

    hopeless = replace(SETTINGS, max_iterations=1, tolerance_m=1e-14, trajectories=0)
    with pytest.raises(SolverError, match="3 of 3 loads"):
        run(hopeless, box_robot(2), box, tracker=Keeper())
    lines = texts["failed_loads.csv"].splitlines()
    assert lines[0] == "sample,p1_pa,p2_pa,force_x_n,force_y_n,force_z_n,reason"
    assert [line.split(",")[0] for line in lines[1:]] == ["0", "1", "2"]
    assert all("Newton stopped after" in line for line in lines[1:])
