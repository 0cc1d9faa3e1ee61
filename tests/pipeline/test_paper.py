"""The rows of the paper: spread over seeds, what is missing says so, nothing is made up."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from softrl import loop, paper
from softrl.core.errors import ConfigError, SolverError
from softrl.pipeline import Outcome
from softrl.report.paper import FULL_SIZE, ROWS, collect, table_of

KEYS = {"table", "row", "unit", "paper", "ours_mean", "ours_std", "seeds", "goal", "command"}


def test_rows_carry_mean_and_spread_or_a_reason() -> None:
    found = collect({"surrogate": [{"heldout/tip_error_mm": 0.1}, {"heldout/tip_error_mm": 0.3}]},
                    {"dynamics": "seed 1: it diverged"}, {"surrogate": "python -m softrl stage=surrogate"}, "quick")  # fmt: skip
    assert len(found) == len(ROWS) and all(set(row) >= KEYS for row in found)
    by_name = {(row["table"], row["row"]): row for row in found}
    assert len(by_name) == len(ROWS)
    ours = by_name[("1", "f_SP, position")]
    assert ours["ours_mean"] == pytest.approx(0.2) and ours["ours_std"] == pytest.approx(0.2 / 2**0.5)
    assert ours["seeds"] == 2 and ours["reason"] == "reduced sizes (profile=quick), 2 of 5 seeds" and ours["command"]
    assert by_name[("1", "f_S, position, one step")]["reason"] == "seed 1: it diverged"
    unmeasured = [row for row in found if row["ours_mean"] is None]
    assert all(row["seeds"] == 0 and row["ours_std"] is None and row["reason"] for row in unmeasured)
    assert json.loads(json.dumps(found)) == found and "not measured" in table_of(found)


@pytest.mark.parametrize(
    ("left", "profile", "reason"),
    [
        (5, "paper", "seed 3: the fit diverged"),
        (4, "paper", "4 of 5 seeds; seed 3: the fit diverged"),
        (4, "quick", "reduced sizes (profile=quick), 4 of 5 seeds; seed 3: the fit diverged"),
        (0, "paper", "seed 3: the fit diverged"),
    ],
)
def test_a_mean_over_the_seeds_that_are_left_says_so(left: int, profile: str, reason: str) -> None:
    found = collect({"surrogate": [{"heldout/tip_error_mm": 0.1}] * left}, {"surrogate": "seed 3: the fit diverged"}, {}, profile)
    ours = next(row for row in found if row["row"] == "f_SP, position")
    assert (ours["seeds"], ours["reason"]) == (left, reason) and reason in table_of(found)


@pytest.mark.parametrize(("recovered", "told"), [(3, "2 of 5 did not recover"), (0, "5 of 5 did not recover"), (5, None)])
def test_no_mean_is_taken_over_those_that_recovered(recovered: int, told: str | None) -> None:
    never, back = {"recovery/recovered_share": 0.0}, {"recovery/recovered_share": 1.0, "recovery_s": 1.5}
    runs = [back] * recovered + [never] * (5 - recovered)
    rows = {row["row"]: row for row in collect({"sim2real": runs}, {}, {}, FULL_SIZE)}
    ours = rows["recovery after a cut air line"]
    assert ours["ours_mean"] == (1.5 if told is None else None) and ours["seeds"] == 5 and ours.get("reason") == told
    assert told is None or f"no mean | 5 | 2 | s | {told}" in table_of(list(rows.values()))
    assert rows["rig, circle"]["seeds"] == 0, "what was not measured at all is told as such"


def settings(**changes: Any) -> dict[str, Any]:
    stage = {
        "seeds": [0, 1],
        "body_seed": 0,
        "tasks": ["hybrid", "track"],
        "rollouts": True,
        "corrected": False,
        "benches": [],
        "minutes": None,
        "keep": None,
    }
    return {"stage": stage | changes, "inputs": {"snapshots": "run:given"}, "profile": {"name": "tiny"}, "out": None}


def test_seeds_share_a_body_and_a_failure_costs_its_own_rows_only(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    ran: list[tuple[str, str, dict[str, str]]] = []

    def run_stage(stage: str, cfg: list[str], folder: Path, made: dict[str, str]) -> Outcome:
        ran.append((stage, " ".join(cfg), dict(made)))
        if stage == "dynamics" and "seed=1" in cfg:
            raise SolverError("it diverged")
        return Outcome(
            stage, f"{stage}-{len(ran)}", False, 1.0, {"heldout/tip_error_mm": 0.1, "circle_mm": 1.0}, folder
        )

    monkeypatch.setattr(paper, "run_stage", run_stage)
    monkeypatch.setattr(paper, "finished_before", lambda stage, cfg, made: "old" if stage in ("mesh", "pod") else None)
    done = paper.run_paper(
        settings(), ["stage=paper", "profile=tiny", "stage.seeds=[0,1]", "seed=9"], tmp_path, lambda w: w
    )
    stages = [stage for stage, _, _ in ran]
    assert stages[:3] == ["mesh", "pod", "calibration"]  # the snapshots are given
    assert stages.count("mesh") == 1 and stages.count("rl") == 4 and stages.count("sim2real") == 4
    assert "16 runs for seeds [0, 1], profile=tiny (reduced sizes" in caplog.text and "2 of them are there" in caplog.text
    assert all("seed=9" not in words and "stage.seeds" not in words for _, words, _ in ran)
    for task in ("track", "hybrid"):  # each rollout has the policy of its own task
        policies = [made["policy"] for stage, words, made in ran if stage == "sim2real" and f"task={task}" in words]
        learned = [f"rl-{i + 1}" for i, (stage, words, _) in enumerate(ran) if stage == "rl" and f"task={task}" in words]
        assert policies == [f"run:{run}" for run in learned]
    rows = {row["row"]: row for row in json.loads((tmp_path / "paper.json").read_text())}
    assert rows["rig, circle"]["seeds"] == 2 and rows["f_S, position, one step"]["ours_mean"] is None
    assert len(done) == len(ran) - 1
    assert rows["f_S, position, one step"]["command"] == "python -m softrl stage=dynamics profile=tiny"


def test_a_stopped_paper_keeps_its_rows_and_says_what_was_not_run(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")

    def run_stage(stage: str, cfg: list[str], folder: Path, made: dict[str, str]) -> Outcome:
        if stage == "dynamics":
            raise SolverError("it diverged")
        if stage == "rl":
            raise KeyboardInterrupt
        return Outcome(stage, stage, False, 1.0, {"heldout/tip_error_mm": 0.1}, folder)

    monkeypatch.setattr(paper, "run_stage", run_stage)
    monkeypatch.setattr(paper, "finished_before", lambda stage, cfg, made: None)
    with pytest.raises(KeyboardInterrupt):
        paper.run_paper(settings(seeds=[0]), ["stage=paper"], tmp_path, lambda w: w)
    rows = {row["row"]: row for row in json.loads((tmp_path / "paper.json").read_text())}
    assert rows["f_SP, position"]["ours_mean"] == pytest.approx(0.1)
    assert rows["f_S, position, one step"]["reason"] == "seed 0: it diverged"
    assert "not run yet" in rows["rig, circle"]["reason"] and rows["rig, circle"]["command"]
    assert "runs to go, about" in caplog.text


def test_what_follows_from_a_diagnosis_leaves_the_nominal_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ran: list[tuple[str, str, dict[str, str]]] = []

    def run_stage(stage: str, cfg: list[str], folder: Path, made: dict[str, str]) -> Outcome:
        ran.append((stage, " ".join(cfg), dict(made)))
        metrics = {"circle_mm": float(len(ran)), "circle_planned_mm": 0.1}
        return Outcome(stage, f"{stage}-{len(ran)}", False, 1.0, metrics, folder)

    monkeypatch.setattr(paper, "run_stage", run_stage)
    monkeypatch.setattr(paper, "finished_before", lambda stage, cfg, made: None)
    paper.run_paper(settings(seeds=[0], corrected=True), ["stage=paper"], tmp_path, lambda w: w)
    stages = [stage for stage, _, _ in ran]
    again = stages.index("diagnosis") + 1
    assert stages[again:] == ["rl", "sim2real", "sim2real", "calibration"]  # the second rollouts of task hybrid
    learned = next(i + 1 for i, (stage, words, _) in enumerate(ran) if stage == "rl" and "task=hybrid" in words)
    assert ran[again + 2][2]["policy"] == f"run:rl-{learned}", "its policy is the one of before, not trained again"
    assert ran[again + 1][2]["policy"] == f"run:rl-{again + 1}"
    assert not any(made.get("calibration") == f"run:calibration-{len(ran)}" for _, _, made in ran)  # last
    for _, words, made in ran[again:]:
        assert "effect=identified" in words and made["diagnosis"] == f"run:diagnosis-{again}"
    assert not any("effect=identified" in words for _, words, _ in ran[:again])
    assert ran[again + 1][2]["calibration"].startswith("run:calibration-") and "policy" in ran[again + 1][2]
    assert ran[again + 1][2]["calibration"] != f"run:calibration-{len(ran)}", "f_RS of the nominal simulator"
    rows = {row["row"]: row["ours_mean"] for row in json.loads((tmp_path / "paper.json").read_text())}
    assert rows["rig, circle"] < rows["rig, circle, policy after the diagnosis"] == again + 2.0
    with pytest.raises(ConfigError, match=r"stage\.corrected=true"):
        paper.run_paper(settings(rollouts=False, corrected=True), [], tmp_path, lambda w: {})


def test_what_stands_on_a_failure_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def run_stage(stage: str, cfg: list[str], folder: Path, made: dict[str, str]) -> Outcome:
        if stage == "surrogate":
            raise SolverError("too small")
        return Outcome(stage, stage, False, 1.0, {}, folder)

    monkeypatch.setattr(paper, "run_stage", run_stage)
    monkeypatch.setattr(paper, "finished_before", lambda stage, cfg, made: None)
    paper.run_paper(settings(seeds=[0]), ["stage=paper"], tmp_path, lambda w: w)
    rows = {row["row"]: row for row in json.loads((tmp_path / "paper.json").read_text())}
    assert rows["simulation, circle"]["reason"] == "seed 0: left out, since surrogate failed"


def test_an_error_of_any_kind_costs_its_own_rows_only(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def run_stage(stage: str, cfg: list[str], folder: Path, made: dict[str, str]) -> Outcome:
        if stage == "dynamics" and "seed=0" in cfg:
            raise np.linalg.LinAlgError("Singular matrix")
        return Outcome(stage, stage, False, 1.0, {}, folder)

    def finished_before(stage: str, cfg: list[str], made: dict[str, str]) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(paper, "run_stage", run_stage)
    monkeypatch.setattr(paper, "finished_before", finished_before)
    done = paper.run_paper(settings(), ["stage=paper"], tmp_path, lambda w: w)
    assert [outcome.stage for outcome in done].count("dynamics") == 1 and "Traceback" in caplog.text
    rows = {row["row"]: row for row in json.loads((tmp_path / "paper.json").read_text())}
    assert rows["f_S, position, one step"]["reason"] == "seed 0: LinAlgError: Singular matrix"


def test_rows_are_kept_in_the_home_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(paper, "run_stage", lambda stage, cfg, folder, made: Outcome(stage, stage, False, 1.0, {}, folder))
    monkeypatch.setattr(paper, "finished_before", lambda stage, cfg, made: None)
    paper.run_paper(settings(seeds=[0], keep="~/rows.json"), ["stage=paper"], tmp_path / "made", lambda w: w)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["home", "made"] and (tmp_path / "home/rows.json").is_file()


def test_seeds_that_repeat_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"stage\.seeds"):
        paper.run_paper(settings(seeds=[1, 1]), [], tmp_path, lambda w: {})


def test_nothing_is_run_on_a_failed_body(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ran = []

    def run_stage(stage: str, cfg: list[str], folder: Path, made: dict[str, str]) -> Outcome:
        ran.append(stage)
        raise SolverError("it diverged")

    monkeypatch.setattr(paper, "run_stage", run_stage)
    monkeypatch.setattr(paper, "finished_before", lambda stage, cfg, made: None)
    assert paper.run_paper(settings(), [], tmp_path, lambda w: w) == [] and ran == ["mesh"]


def test_an_error_of_many_lines_and_bars_stays_in_its_row() -> None:
    told = table_of(collect({}, {"surrogate": "seed 0: RuntimeError: shapes\n  (3|4) differ"}, {}, FULL_SIZE)).splitlines()
    assert len(told) == len(ROWS) + 2 and all(line.startswith("|") for line in told)
    ours = next(line for line in told if "f_SP, position" in line)
    assert ours.endswith(r"| seed 0: RuntimeError: shapes (3\|4) differ |")


def configured(monkeypatch: pytest.MonkeyPatch, folder: Path, finished: list[Outcome]) -> None:
    """Run what the command line asks for, with runs behind the paper's tables that have ``finished``."""
    chosen = SimpleNamespace(output_dir=str(folder), choices=SimpleNamespace(stage="paper"))
    node = SimpleNamespace(runtime=chosen, overrides=SimpleNamespace(task=[]))
    monkeypatch.setattr(loop, "HydraConfig", SimpleNamespace(get=lambda: node))
    monkeypatch.setattr(loop, "_plain", lambda cfg: {})
    monkeypatch.setattr(loop, "run_paper", lambda *_: finished)
    loop.run_configured(OmegaConf.create())


def test_where_every_run_fails_the_table_is_named_that_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(SolverError, match=r"none of the runs .* finished; .*paper\.md says why"):
        configured(monkeypatch, tmp_path, [])


def test_it_ends_in_the_papers_rows_of_which_each_says_what_it_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    (tmp_path / "paper.md").write_text("| 2 | simulation, hybrid task, position |")
    tasks = [Outcome("rl", name, False, 1.0, {"heldout/circle_position_rmse_mm": 0.1}, tmp_path) for name in "ab"]
    configured(monkeypatch, tmp_path, tasks)
    assert "simulation, hybrid task, position" in caplog.text and "heldout/circle" not in caplog.text


def test_a_task_that_does_not_exist_is_told_before_anything_is_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def compose(words: list[str]) -> dict[str, Any]:
        if "task=trak" in words:
            raise ConfigError("task=trak is unknown")
        return {}

    ran: list[str] = []
    monkeypatch.setattr(paper, "run_stage", lambda stage, *_: ran.append(stage))
    monkeypatch.setattr(paper, "finished_before", lambda stage, cfg, made: None)
    with pytest.raises(ConfigError, match="task=trak"):
        paper.run_paper(settings(tasks=["trak", "track"]), ["stage=paper"], tmp_path, compose)
    assert not ran
