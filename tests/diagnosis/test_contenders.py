"""Which of many leads are fitted in full."""

import numpy as np

from softrl.diagnosis.fitting.hypothesis import Choice, Gate, effect_axes, may_be_pinned, neutral
from softrl.diagnosis.search.moves import _contenders
from softrl.diagnosis.search.rank import Lead


def lead(choice: Choice, gain: float) -> Lead:
    return Lead(choice, neutral(choice), gain)


def test_the_form_for_all_chambers_is_among_those_of_its_name() -> None:
    leads = [
        lead(Choice("deadband"), 0.16), lead(Choice("rate_limit", 1), 0.09), lead(Choice("rate_limit", 0), 0.08),
        lead(Choice("rate_limit"), 0.06), lead(Choice("rate_limit", 2), 0.055),
    ]  # fmt: skip
    taken = [group[0].choice for group in _contenders(leads, 5)]
    assert taken == [Choice("deadband"), Choice("rate_limit", 1), Choice("rate_limit")]


def test_what_gains_too_little_is_left_out_though_it_acts_everywhere() -> None:
    leads = [lead(Choice("lag", 1), 0.5), lead(Choice("lag"), 0.1)]
    assert [group[0].choice for group in _contenders(leads, 5)] == [Choice("lag", 1)]


def test_forms_that_differ_by_where_the_gate_began_are_one_fit_with_several_starts() -> None:
    early, late = (Choice("frame", gate=Gate("since_s", begin)) for begin in (5.0, 11.0))
    leads = [lead(early, 0.7), lead(Choice("payload"), 0.6), lead(late, 0.5)]
    groups = _contenders(leads, 2)
    assert [[one.choice for one in group] for group in groups] == [[early, late], [Choice("payload")]]


def test_bounded_lags_do_not_crowd_out_a_delay() -> None:
    lags = [lead(Choice(name), 0.9 - 0.01 * k) for k, name in enumerate(("lag", "rate_limit", "flow_limit", "pi_regulator"))]
    groups = _contenders([*lags, lead(Choice("delay"), 0.8)], 2)
    assert [group[0].choice.name for group in groups] == ["lag", "rate_limit", "flow_limit", "pi_regulator", "delay"]


def test_what_came_close_before_is_fitted_again_unless_it_saves_nothing() -> None:
    leads = [lead(Choice("tube_line"), 0.8), lead(Choice("gain"), 0.7), lead(Choice("delay"), 0.1), lead(Choice("offset"), 0.0)]
    groups = _contenders(leads, 2, close={Choice("delay"), Choice("offset")})
    assert [group[0].choice.name for group in groups] == ["tube_line", "gain", "delay"]


def test_a_deadband_is_never_left_without_its_band() -> None:
    choice = Choice("deadband")
    assert "band" in [axis.name for axis in effect_axes(choice)] and "band" not in may_be_pinned(choice)
    assert "closes_at" in may_be_pinned(choice) and np.isfinite(neutral(choice)).all()
