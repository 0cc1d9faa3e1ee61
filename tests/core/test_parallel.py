"""The same tasks give the same results in one process, in several, and on a cluster that loses a worker."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import hydra
import numpy as np
import pytest
from hydra.errors import ConfigCompositionException

from softrl.__main__ import _one_line, _spell_out
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ConfigError
from softrl.core.parallel import LOCAL, Parallel, seeds
from softrl.core.resume import Kept
from softrl.core.tracking import NullTracker
from softrl.fem.stage import run as run_fem
from tests.fem.bodies import box_robot, hollow_box
from tests.fem.test_stage import CONFIG

ROOT = Path(__file__).resolve().parents[2]
TASKS = 12


def draw(seed: np.random.SeedSequence, folder: str = "", pause_s: float = 0.0) -> tuple[float, int]:
    """Return a number that depends on the seed alone, and who drew it."""
    if folder:
        (Path(folder) / f"{seed.spawn_key[0]}.{os.getpid()}").touch()
        time.sleep(pause_s)
    return float(np.random.default_rng(seed).standard_normal(1000).sum()), os.getpid()


def values(parallel: Parallel, processes: int = 1, *more: object) -> list[float]:
    """Return the draws in the order of the tasks."""
    found = dict(parallel.map(draw, [(seed, *more) for seed in seeds(3, TASKS)], processes))
    return [found[number][0] for number in range(TASKS)]


def test_processes_do_not_change_a_result() -> None:
    assert values(LOCAL) == values(LOCAL, 2) == [draw(seed)[0] for seed in seeds(3, TASKS)]
    assert len(set(values(LOCAL))) == TASKS
    assert list(LOCAL.map(draw, [])) == []


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Yield the address of a Dask scheduler on this machine and its two workers."""
    pytest.importorskip("distributed")
    words = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    words += ["--scheduler-file", str(tmp_path / "scheduler.json")]
    settings = os.environ | {
        "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__DISK": "false", "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    quiet = {"cwd": tmp_path, "env": settings, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = subprocess.Popen(words, **quiet)  # type: ignore[call-overload]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(tmp_path / "scheduler.json")]
    worker += ["--nthreads", "1", "--no-nanny", "--host", "127.0.0.1", "--no-dashboard"]
    workers: list[subprocess.Popen[bytes]] = []
    try:
        until = time.monotonic() + 60
        while not (tmp_path / "scheduler.json").is_file() and time.monotonic() < until:
            time.sleep(0.1)
        address = json.loads((tmp_path / "scheduler.json").read_text())["address"]
        workers += [subprocess.Popen(worker, **quiet) for _ in range(2)]  # type: ignore[call-overload]
        from distributed import Client

        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield address, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_loses_nothing(
    cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, workers = cluster
    seen, found = tmp_path / "seen", {}
    seen.mkdir()
    dask = Parallel("dask", None, address)
    for number, result in dask.map(draw, [(seed, str(seen), 0.4) for seed in seeds(3, TASKS)]):
        found[number] = result
        if len(found) == 3:  # midway, while both workers hold tasks
            workers[0].send_signal(signal.SIGKILL)
    assert [found[number][0] for number in range(TASKS)] == values(LOCAL)
    runners = {int(path.suffix[1:]) for path in seen.iterdir()}
    assert runners == {worker.pid for worker in workers}
    again = [path.stem for path in seen.iterdir()]
    assert len(again) > TASKS, "the dead worker held a task, which the other one works off again"


def test_a_cluster_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("softrl.core.parallel.CONNECT_S", 1)
    with pytest.raises(ConfigError, match=r"parallel\.address=tcp://127\.0\.0\.1:9"):
        list(Parallel("dask", None, "tcp://127.0.0.1:9").map(draw, [(seeds(0, 1)[0],)]))


def test_what_is_missing_for_dask_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"softrl\[cluster\]"):
        list(Parallel("dask", None, "tcp://127.0.0.1:9").map(draw, [(seeds(0, 1)[0],)]))


@pytest.mark.parametrize(
    ("node", "says"), [(("ray", None, None), "parallel.backend=ray"), (("dask", None, None), "parallel.address=None"),
                       (("loky", 0, None), "parallel.processes=0"), (("loky", 2, "tcp://a:1"), "loky takes none")]
)  # fmt: skip
def test_bad_settings_are_refused(node: tuple[str, int | None, str | None], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        Parallel(*node)


def test_kept_parts_are_whole_or_absent(tmp_path: Path) -> None:
    kept = Kept("work", "mark", tmp_path / "home")
    assert "a" not in kept
    kept.save("a", {"x": np.arange(3.0), "y": np.asarray(2)})
    (kept.folder / "b.7.part").write_bytes(b"half")
    assert "a" in kept and "b" not in kept
    assert kept.load("a")["x"].tolist() == [0.0, 1.0, 2.0]
    assert "a" not in Kept("work", "other", tmp_path / "home")
    kept.clear()
    assert list(tmp_path.iterdir()) == []


def test_a_sweep_goes_to_slurm() -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    with hydra.initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        node = hydra.compose("config", ["stage=mesh", "hydra/launcher=slurm"], return_hydra_config=True)
    assert node.hydra.launcher._target_.endswith("SlurmLauncher") and node.hydra.launcher.timeout_min > 0


def test_a_missing_launcher_is_one_line() -> None:
    assert _spell_out("launcher=slurm") == ["hydra/launcher=slurm"]
    assert _spell_out("bench=rl,policy") == ["bench=[rl,policy]"] and _spell_out("bench=fem") == ["bench=fem"]
    assert _spell_out("bench=rl,policy", sweep=True) == ["bench=rl,policy"]
    missing = ConfigCompositionException("In 'hydra/launcher/slurm': Could not load 'hydra/launcher/submitit_slurm'.")
    assert "softrl[slurm]" in _one_line(missing) and "\n" not in _one_line(missing)


@pytest.mark.slow
def test_the_fem_stage_gives_the_same_artifact_on_a_cluster(
    cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    robot, box = box_robot(2), hollow_box(chambers=2)
    settings = replace(CONFIG, equilibria=3, paths=2, trajectories=1, processes=2)
    here = run_fem(settings, robot, box, tracker=NullTracker())
    there = run_fem(settings, robot, box, Parallel("dask", None, cluster[0]), tracker=NullTracker())
    for field in fields(Snapshots):
        one, two = ({"": v} if not isinstance(v, dict) else v for v in (getattr(s, field.name) for s in (here, there)))
        assert one.keys() == two.keys() and all(np.array_equal(one[name], two[name]) for name in one), field.name
