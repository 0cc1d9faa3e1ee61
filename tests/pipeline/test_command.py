"""The command line as a user meets it: errors in one line, reuse, resume, sweeps."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from softrl.core.store import Location, Store
from tests.pipeline.command import softrl

MISTAKES = [
    (["stage=mesh", "stage.unitm=3"], "stage.unitm"),
    (["stage=mesh", "+stage.unitm=3"], "did you mean unit_m?"),
    (["stage=mesh", "stage.unit_m=abc"], "expected float"),
    (["stage=mesh", "robot.mass_kg=-1"], "robot.mass_kg=-1"),
    (["stage=mesh", "+experiments=nothing"], "experiments/nothing"),
    (["stage=mesh", "+sed=3"], "sed=3 is an unknown key"),
    (["stage=nothing"], "stage/nothing"),
    (["stage=all", "stage.unit_m=1"], "needs that stage alone"),
    (["stage=pod"], "run stage=fem first"),
    (["stage=pod", "inputs.snapshots=run:0"], "run:0 is not in this tracking store"),
    (["stage=simulate", "simulator=pcc", "recordings=nowhere"], "nowhere is no folder"),
    (["stage=mesh", "inputs.mehs=latest"], "snapshots (of stage=fem)"),
    (["stage=mesh", "driver=nothing"], "'driver': rig_serial rig_udp"),
    (["stage=mesh", "robot=nowhere.yaml"], "robot=nowhere.yaml cannot be read"),
    (["stage=mesh", "effect=[lag,gain]"], "effect=[lag,gain] plays no part in stage=mesh; leave it out"),
    (["stage=diagnosis", "effect=run:1a"], "effect=run:1a plays no part in stage=diagnosis; leave it out: it looks for all"),
]
# a process for each command, all of them forked from one that has imported what takes long
FORKED = """
import json, os, sys
import softrl.loop, softrl.mesh.stage, softrl.pod.stage, softrl.simulate.stage
from softrl.__main__ import main
ends = []
for number, words in enumerate(json.loads(sys.argv[1])):
    with open(f"{number}.txt", "w") as told:
        child = os.fork()
        if not child:
            os.dup2(told.fileno(), 2)
            sys.argv[1:] = words
            main()
            sys.exit()
    ends.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
print(json.dumps(ends))
"""


def test_a_mistake_is_one_line_and_status_2(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FORKED, json.dumps([words for words, _ in MISTAKES])]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600)
    assert json.loads(done.stdout.splitlines()[-1]) == [2] * len(MISTAKES), done.stderr
    for number, (_, says) in enumerate(MISTAKES):
        told = (tmp_path / f"{number}.txt").read_text()
        lines = [line for line in told.splitlines() if line.startswith("softrl: ")]
        assert len(lines) == 1 and says in lines[0], told
        assert "Traceback" not in told


def test_a_robot_may_be_a_file_of_its_own(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "conf" / "robot" / "tripod.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("name: tripod", "name: mine"))
    shown = softrl(tmp_path, "stage=mesh", "robot=mine.yaml", "robot.mass_kg=2.5", "--cfg", "job").stdout
    assert "  name: mine\n" in shown and "  mass_kg: 2.5\n" in shown
    (tmp_path / "mine.yaml").write_text("- mine\n")
    assert "robot=mine.yaml cannot be read (it has no keys)" in softrl(tmp_path, "stage=mesh", "robot=mine.yaml").stderr


def test_help_is_quick_to_say_what_one_can_do(tmp_path: Path) -> None:
    done = softrl(tmp_path, "--help")
    assert done.returncode == 0 and "stage=diagnosis" in done.stdout and "_rig" not in done.stdout
    loaded = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "softrl", "--help"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    ).stderr
    assert not any(f" {heavy}\n" in loaded for heavy in ("torch", "mlflow", "numba", "pybullet"))


def test_a_finished_run_is_reused_until_forced(tmp_path: Path) -> None:
    words = ["stage=mesh", "profile=tiny"]
    first, second, third = (
        softrl(tmp_path, *words, *more, f"hydra.run.dir=out/{k}", f"out=copy/{k}")
        for k, more in enumerate([[], [], ["force=true"]])
    )
    for k in range(3):  # made or reused
        assert (tmp_path / f"copy/{k}/mesh/arrays.npz").is_file() and (tmp_path / f"copy/{k}/result.json").is_file()
    assert [run.returncode for run in (first, second, third)] == [0, 0, 0], third.stderr
    ids = [json.loads((tmp_path / f"out/{k}/result.json").read_text())["run_id"] for k in range(3)]
    assert ids[0] == ids[1] != ids[2]
    assert "reused" in second.stderr


def test_a_run_whose_files_are_gone_is_made_again(tmp_path: Path) -> None:
    first = softrl(tmp_path, "stage=mesh", "profile=tiny")
    shutil.rmtree(tmp_path / "mlartifacts")
    again = softrl(tmp_path, "stage=mesh", "profile=tiny")
    assert (first.returncode, again.returncode) == (0, 0) and "its files are gone; it is run again" in again.stderr, again.stderr


def test_a_reused_run_writes_its_dataset_again(tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.1f},{k % 20},0,0" for k in range(40)]
    (tmp_path / "given").mkdir()
    (tmp_path / "given" / "run.csv").write_text("\n".join(["time_s,p1_cmd_kpa,p2_cmd_kpa,p3_cmd_kpa", *rows]) + "\n")
    (tmp_path / "given" / "dataset.yaml").write_text("robot: tripod\n")
    words, made = ("stage=simulate", "simulator=pcc", "recordings=given", "out=made"), []
    for effect in ("lag", "gain", "lag"):
        done = softrl(tmp_path, *words, f"effect=[{effect}]")
        assert done.returncode == 0, done.stderr
        made.append((tmp_path / "made" / "run.csv").read_text())
    assert "reused" in done.stderr and made[0] == made[2] != made[1]
    done = softrl(tmp_path, *words[:3], "out=given", "effect=[lag]")
    assert done.returncode == 2 and "not simulated" in done.stderr and "started" not in done.stderr, "refused before the work"


def test_a_sweep_is_one_parent_with_a_child_per_point(tmp_path: Path) -> None:
    done = softrl(tmp_path, "-m", "stage=mesh", "profile=tiny", "seed=1,2", "force=true", "out=copy")
    assert done.returncode == 0, done.stderr
    seeds = [json.loads((tmp_path / f"copy/{k}/config.json").read_text())["seed"] for k in range(2)]
    assert seeds == [1, 2], "each has a folder of its own"
    store = Store(Location(None, str(tmp_path)))
    runs = store.client.search_runs([store.experiment])
    assert done.stderr.count("point ") == 1 and "\nseed=1 " in done.stderr and "\nseed=2 " in done.stderr
    parents = [run for run in runs if run.data.tags["softrl.stage"] == "sweep:mesh"]
    assert len(parents) == 1 and parents[0].info.status == "FINISHED"
    assert len(store.points(parents[0].info.run_id)) == 2
    assert parents[0].data.metrics  # the page shows a collapsed parent only


def test_a_mistake_at_a_point_comes_back_from_its_process(tmp_path: Path) -> None:
    words = ("-m", "stage=mesh", "profile=tiny", "launcher=joblib", "hydra.launcher.n_jobs=2")
    done = softrl(tmp_path, *words, "stage.source=sample,missing.stl")
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    assert any(line.startswith("softrl: ") and "missing.stl" in line for line in done.stderr.splitlines()), done.stderr
    assert "1 points of the sweep finished" in done.stderr  # the other was not lost


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("sinfo") is None, reason="needs a Slurm cluster")
def test_a_sweep_runs_on_slurm(tmp_path: Path) -> None:
    done = softrl(tmp_path, "-m", "stage=mesh", "profile=tiny", "launcher=slurm", "hydra.launcher.mem_gb=2", "seed=1,2")
    assert done.returncode == 0, done.stderr
    assert "\nseed=1 " in done.stderr and "\nseed=2 " in done.stderr


def test_a_killed_stage_is_marked_failed_and_the_next_try_finishes(tmp_path: Path) -> None:
    assert softrl(tmp_path, "stage=mesh", "profile=tiny").returncode == 0
    process = subprocess.Popen(
        [sys.executable, "-m", "softrl", "stage=fem", "profile=tiny", "stage.equilibria=400"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if "fem: started" in line:
            break
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    done = softrl(tmp_path, "stage=fem", "profile=tiny", "stage.equilibria=4", "stage.trajectories=0")
    assert done.returncode == 0, done.stderr
    assert "was killed; it is marked failed" in done.stderr
    store = Store(Location(None, str(tmp_path)))
    status = [run.info.status for run in store.client.search_runs([store.experiment], "tags.`softrl.stage` = 'fem'")]
    assert sorted(status) == ["FAILED", "FINISHED"]
