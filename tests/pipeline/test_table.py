"""The closing table shows what a stage has, and names only metrics that stages log."""

from pathlib import Path

from softrl.pipeline import STAGES, Outcome
from softrl.report.table import HEADLINES, sweep_table, table


def test_headlines_belong_to_stages() -> None:
    assert set(HEADLINES) <= set(STAGES)


def test_short_table_keeps_headlines_and_single_stage_shows_all(tmp_path: Path) -> None:
    metrics = {"circle_mm": 3.5, "samples": 10.0, "train/x": 1.0}
    outcome = Outcome("sim2real", "id", False, 2.0, metrics, tmp_path)
    alone, both = table([outcome]), table([outcome, outcome])
    assert "samples" in alone and "train/x" not in alone
    assert "circle_mm" in both and "samples" not in both


def test_a_sweep_shows_what_any_of_its_points_measured() -> None:
    """A diagnosis of data that cannot tell has no errors, and may be the first."""
    measured = {"heldout/corrected_error_mm": 0.17}
    points = [("seed=0 recordings=a", "aaaaaaaaaa", {}), ("seed=0 recordings=b", "bbbbbbbbbb", measured)]
    told = sweep_table("diagnosis", points).splitlines()
    assert told[0] == "[1] heldout/corrected_error_mm" and told[2].split() == ["recordings=a", "aaaaaaaa", "-"]
    assert told[3].split() == ["recordings=b", "bbbbbbbb", "0.17"]
