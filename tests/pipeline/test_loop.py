"""The whole loop in miniature: its stages follow from each other, and do the same again."""

import json
from pathlib import Path

import pytest

from softrl.pipeline import STAGES
from tests.pipeline.command import softrl


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the tiny loop has run once."""
    folder = tmp_path_factory.mktemp("loop")
    done = softrl(folder, "stage=all", "profile=tiny", "hydra.run.dir=out")
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def test_the_loop_closes_and_its_inputs_are_linked(loop: Path) -> None:
    found = {stage: json.loads((loop / "out" / stage / "result.json").read_text()) for stage in STAGES}
    assert all(result["status"] == "finished" and result["metrics"] for result in found.values())
    ids = {result["run_id"] for result in found.values()}
    assert len(ids) == len(STAGES)
    for stage in STAGES[1:]:
        assert found[stage]["inputs"], stage
        assert set(found[stage]["inputs"].values()) <= ids
    document = json.loads((loop / "out/diagnosis/diagnosis.json").read_text())
    assert document["verdict"] in ("nothing missing", "named", "indistinguishable", "unknown")
    assert (loop / "out/diagnosis/report.html").is_file()


def test_an_identified_correction_is_accepted_by_another_stage(loop: Path) -> None:
    run_id = json.loads((loop / "out/diagnosis/result.json").read_text())["run_id"]
    recordings = json.loads((loop / "out/sim2real/result.json").read_text())["artifacts"]["recording_set"]
    done = softrl(loop, "stage=simulate", "profile=tiny", f"effect=run:{run_id}", f"recordings={recordings}")
    assert done.returncode == 0, done.stderr
    result = json.loads(next((loop / "outputs").rglob("result.json")).read_text())
    assert run_id in result["inputs"].values()


@pytest.mark.slow
def test_a_stage_that_runs_again_gives_the_same_numbers(loop: Path) -> None:
    """Dynamics as in the loop; the others as when run before: beside dynamics their sums round otherwise, to 1e-5."""
    for stage in ("dynamics", "surrogate", "rl"):
        places = ["again"] if stage == "dynamics" else ["again", "once_more"]
        for place in places:
            done = softrl(loop, f"stage={stage}", "profile=tiny", "force=true", f"hydra.run.dir={place}/{stage}")
            assert done.returncode == 0, done.stderr
        pair = [*(["out"] if stage == "dynamics" else []), *places]
        found = [json.loads((loop / place / stage / "result.json").read_text())["metrics"] for place in pair]
        timed = ("_per_s", "_hz", "seconds", "_ms")
        first, second = ({k: v for k, v in m.items() if not k.endswith(timed) and "cpu_s" not in k} for m in found)
        assert first == second, stage
