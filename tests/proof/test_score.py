"""Scores of a hand-made table, with intervals from the literature's formula worked by hand."""

from typing import Any

import numpy as np
import pytest

from softrl.proof.figures import confusion, detection
from softrl.proof.score import coverage, gap_closed, metrics, misses, pinned, row_of, shares, wilson

ERRORS = {
    split: {"oracle": 0.2, "nominal": 4.2, "retuned": 2.0, "corrected": 0.6, "blackbox": 3.0}
    for split in ("heldout", "outside")
}


def key(case: int, stratum: str, *hidden: tuple[str, tuple[str, ...]], loud: float = 5.0) -> dict[str, Any]:
    entries = [{"name": n, "right": list(r), "chamber": -1, "parameters": {}} for n, r in hidden]
    return {"case": case, "stratum": stratum, "hidden": entries, "places": ["everywhere"] * len(entries),
            "signal_to_noise": loud if hidden else 0.0, "measured_pressure": True, "body_discrepancy_mm": 0.1}  # fmt: skip


def said(verdict: str, *names: str) -> dict[str, Any]:
    effects = [{"name": n, "chamber": -1, "parameters": {}} for n in names]
    return {"verdict": verdict, "effects": effects, "rivals": [], "located": [], "seconds": 10.0}


@pytest.mark.parametrize(
    ("hits", "trials", "low", "high"),
    [(8, 10, 49.0, 94.3), (0, 10, 0.0, 27.8), (10, 10, 72.2, 100.0), (1, 2, 9.5, 90.5), (95, 100, 88.8, 97.8)],
)
def test_wilson_intervals(hits: int, trials: int, low: float, high: float) -> None:
    share = wilson(hits, trials)
    assert share.pct == pytest.approx(100.0 * hits / trials)
    assert (share.low, share.high) == pytest.approx((low, high), abs=0.06)


def test_a_table_by_hand() -> None:
    lag, creep = ("spool", ("lag", "tube_line")), ("powerlaw", ("viscoelasticity",))
    table = [
        (key(0, "null"), said("nothing missing")),
        (key(1, "nuisance"), said("unknown")),  # a false alarm
        (key(2, "single", lag), said("named", "tube_line")),
        (key(3, "single", lag), said("named", "payload", "lag")),  # right, but not first
        (key(4, "single", lag, loud=0.3), said("nothing missing")),  # too faint to count
        (key(5, "pair", lag, creep), said("named", "viscoelasticity", "lag")),
        (key(6, "pair", lag, creep), said("named", "lag")),
        (key(7, "outside", ("twist", ())), said("unknown")),
        (key(8, "outside", ("twist", ())), said("named", "frame")),
    ]
    rows = [row_of(k, s, ERRORS, 1.0) for k, s in table]
    found = metrics(rows, 1, 4)
    assert found["cases"] == 9 and found["detectable_singles"] == 2
    assert found["top1_pct"] == 50.0 and found["top1_low_pct"] == pytest.approx(9.5, abs=0.06)
    assert found["pairs_both_pct"] == 50.0 and found["false_alarm_pct"] == 50.0 and found["unknown_flagged_pct"] == 50.0
    assert found["gap_closed_heldout_median_pct"] == pytest.approx(90.0) == found["gap_closed_ood_median_pct"]
    assert found["gap_closed_ood_retuned_median_pct"] == pytest.approx(55.0)
    assert found["gap_closed_ood_blackbox_median_pct"] == pytest.approx(30.0)
    assert found["blackbox_ood_ratio"] == pytest.approx(5.0) and found["retuned_ood_ratio"] == pytest.approx(2.0 / 0.6)
    assert (found["shuffled_finds"], found["shuffled_cases"], found["seconds_per_case"]) == (1, 4, 10.0)
    assert np.isnan(found["interval_coverage_pct"])
    assert [line.split(",")[0] for line in misses(rows)] == ["case 1", "case 3", "case 6", "case 8"]


def test_a_crash_is_a_miss_that_closes_no_gap() -> None:
    crashed = {"verdict": "crashed", "error": "ValueError: x", "seconds": 1.0}
    row = row_of(key(0, "single", ("spool", ("lag",))), crashed, {"heldout": {}, "outside": {}}, 1.0)
    assert not row["top1"] and gap_closed(row, "outside") == 0.0
    found = metrics([row], 0, 0)
    assert found["top1_pct"] == found["gap_closed_ood_median_pct"] == found["blackbox_ood_ratio"] == 0.0
    assert "ValueError" in misses([row])[0]


def test_the_gap_closed_stands_beside_its_baselines_and_the_worse_cases() -> None:
    """Retuning alone may close most of the gap, and a median does not see a correction that closes none."""
    rows = []
    for number, error in enumerate((0.2, 0.2, 0.2, 4.2)):
        errors = {"outside": ERRORS["outside"], "heldout": ERRORS["heldout"] | {"corrected": error, "retuned": 0.2 + number}}
        rows.append(row_of(key(number, "single", ("spool", ("lag",))), said("named", "lag"), errors, 1.0))
    found = metrics(rows, 0, 0)
    assert found["gap_closed_heldout_median_pct"] == pytest.approx(100.0)
    assert found["gap_closed_heldout_lower_quartile_pct"] == pytest.approx(75.0)
    assert found["gap_closed_heldout_retuned_median_pct"] == pytest.approx(62.5)  # of 100, 75, 50, 25
    assert found["gap_closed_heldout_blackbox_median_pct"] == pytest.approx(30.0)


def test_intervals_count_where_both_forms_mean_the_same() -> None:
    hidden = key(0, "single", ("mass", ("payload",)))
    hidden["hidden"][0]["parameters"] = {"payload.mass": 0.2}
    answers = said("named", "payload")
    for low, high, wanted in ((0.15, 0.25, (1, 1)), (0.21, 0.25, (0, 1)), (-np.inf, np.inf, (0, 0))):
        answers["effects"][0]["parameters"] = {"mass": {"value": 0.22, "low": low, "high": high}}
        assert coverage(hidden, answers) == wanted
    assert coverage(hidden, said("named", "tether")) == (0, 0)


def test_a_hidden_parameter_that_is_told_as_neutral_counts_by_its_interval_if_it_has_one() -> None:
    hidden = key(0, "single", ("turned", ("frame",)))
    hidden["hidden"][0]["parameters"] = {"frame.shift_x": 0.002, "frame.shift_y": 0.001, "frame.turn_z_rad": 0.02}
    answers = said("named", "frame")
    answers["effects"][0] |= {"parameters": {"turn_z_rad": {"value": 0.02, "low": 0.01, "high": 0.03}},
                              "pinned": {"shift_x": 0.0, "shift_y": 0.0, "turn_y_rad": 0.0}}  # fmt: skip
    assert coverage(hidden, answers) == (1, 1) and pinned(hidden, answers) == 2
    about = {"shift_x": {"low": 0.0, "high": 0.001}, "shift_y": {"low": -0.001, "high": 0.001}}
    told = answers | {"effects": [answers["effects"][0] | {"pinned_intervals": about}]}
    assert coverage(hidden, told) == (2, 3) and pinned(hidden, told) == 2
    assert pinned(hidden, said("named", "tether")) == 0
    found = metrics([row_of(hidden, answers, ERRORS, 1.0)] * 3, 0, 0)
    assert found["interval_coverage_pct"] == 100.0 and found["hidden_parameters_pinned"] == 6


@pytest.mark.parametrize(
    ("right", "hidden_in", "told", "chamber_right", "one_chamber_right"),
    [
        ("gain", 1, ("gain", 1), True, True),
        ("gain", 1, ("gain", 2), False, False),
        ("gain", 1, ("gain", -1), False, False),
        ("lag", -1, ("lag", -1), True, None),
        ("lag", -1, ("lag", 0), False, None),
        ("payload", -1, ("payload", -1), None, None),  # has no chamber, so that it cannot be wrong
        ("gain", 1, ("lag", 1), None, None),
    ],
)
def test_only_an_effect_that_has_a_chamber_can_be_right_about_it(
    right: str, hidden_in: int, told: tuple[str, int], chamber_right: bool | None, one_chamber_right: bool | None
) -> None:
    hidden, answers = key(0, "single", ("law", (right,))), said("named", told[0])
    hidden["hidden"][0]["chamber"], answers["effects"][0]["chamber"] = hidden_in, told[1]
    row = row_of(hidden, answers, ERRORS, 1.0)
    assert (row["chamber_right"], row["one_chamber_right"]) == (chamber_right, one_chamber_right)
    assert shares([row])["named/chamber_right"].trials == (chamber_right is not None)
    assert shares([row])["named/one_chamber_right"].trials == (one_chamber_right is not None)


def test_a_crash_is_told_and_so_is_a_wrong_name_for_what_is_too_faint_to_be_named() -> None:
    lag, creep = ("spool", ("lag",)), ("powerlaw", ("viscoelasticity",))
    crashed = {"verdict": "crashed", "error": "ValueError: x", "seconds": 1.0}
    nothing: dict[str, Any] = {"heldout": {}, "outside": {}}
    rows = [
        row_of(key(0, "single", lag, loud=0.3), crashed, nothing, 1.0),
        row_of(key(1, "single", lag, loud=0.3), said("named", "payload"), ERRORS, 1.0),
        row_of(key(2, "outside", ("twist", ()), loud=0.3), said("named", "frame"), ERRORS, 1.0),
        row_of(key(3, "concealed", lag, loud=0.3), said("named", "command_map"), ERRORS, 1.0),  # which the map is
        row_of(key(4, "single", lag, loud=0.3), said("nothing missing"), ERRORS, 1.0),
        row_of(key(5, "single", creep, loud=0.3), said("named", "viscoelasticity"), ERRORS, 1.0),
    ]
    assert [line.split(",")[0] for line in misses(rows)] == ["case 0", "case 1", "case 2"]


@pytest.mark.parametrize("first", [0, 1])
def test_an_effect_in_two_chambers_is_scored_by_the_one_it_is_hidden_in(first: int) -> None:
    hidden = key(0, "single", ("gain", ("gain",)))
    hidden["hidden"][0] |= {"chamber": 0, "parameters": {"gain.gain": 1.2}}
    answers = said("named", "gain", "gain")
    for chamber, (low, high) in enumerate(((0.9, 1.1), (1.1, 1.3))):
        told = {"chamber": chamber, "parameters": {"gain": {"value": 0.5 * (low + high), "low": low, "high": high}}}
        answers["effects"][(first + chamber) % 2] |= told
    assert coverage(hidden, answers) == (0, 1)


def test_no_crash_is_drawn_as_something_found_and_the_legend_names_all() -> None:
    lag = ("spool", ("lag",))
    rows = [row_of(key(k, "single", lag), {"verdict": verdict, "seconds": 1.0}, ERRORS, 1.0)
            for k, verdict in enumerate(("crashed", "cannot tell", "unknown", "unknown"))]  # fmt: skip
    axis = detection(rows, 1.0).axes[0]
    assert [label.get_text() for label in axis.get_legend().get_texts()] == [
        "called detectable", "something found", "named first and right"
    ]  # fmt: skip
    points = [np.asarray(line.get_ydata())[0] for line in axis.lines if line.get_marker() == "o"]
    assert points == [50.0, 0.0]


def test_a_frame_about_answers_of_which_some_are_right_says_how_many() -> None:
    """With a gauge a latency is no dead time: one cell of the table holds right answers and wrong ones."""
    rights = (("delay", "dead_time"), ("delay",), ("delay",))
    rows = [row_of(key(k, "single", ("latency", right)), said("named", "dead_time"), ERRORS, 1.0)
            for k, right in enumerate(rights)]  # fmt: skip
    axis = confusion(rows).axes[0]
    assert [text.get_text() for text in axis.texts] == ["1 of 3"] and len(axis.patches) == 1


def test_two_names_for_one_law_are_told_though_each_alone_would_be_right() -> None:
    slip = ("slip", ("hysteresis", "play"))
    rows = [row_of(key(k, "single", slip), said("named", *names), ERRORS, 1.0)
            for k, names in enumerate((("play",), ("play", "hysteresis")))]  # fmt: skip
    found = shares(rows)
    assert found["singles/nothing_wrong_named"].hits == 2 and found["singles/nothing_else_named"].hits == 1


def test_what_is_too_faint_stands_apart_in_the_table_of_answers() -> None:
    """Of it no answer is asked: beside one that is plain it would look like a miss."""
    rows = [row_of(key(k, "single", ("spool", ("lag",)), loud=loud), said(verdict, *names), ERRORS, 1.0)
            for k, (loud, verdict, *names) in enumerate(((5.0, "named", "lag"), (0.3, "nothing missing")))]  # fmt: skip
    labels = [label.get_text() for label in confusion(rows).axes[0].get_yticklabels()]
    assert labels == ["spool", "spool (too faint)"]
