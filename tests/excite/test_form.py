"""What a diagnosis left open is planned for in the form in which it was found."""

from dataclasses import replace
from typing import Any

import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.errors import ConfigError
from softrl.effects.failure import Failure
from softrl.effects.gain import Gain
from softrl.effects.knee import Knee
from softrl.excite.form import form_of, form_of_label
from softrl.excite.rival import NOTHING, rivals_of
from tests.excite.test_plan import body, robot


def entry(name: str, chamber: int = -1, parameters: dict[str, float] | None = None, **further: Any) -> dict[str, Any]:
    told = {n: {"value": v, "low": v, "high": v, "unit": "1"} for n, v in (parameters or {}).items()}
    return {"name": name, "chamber": chamber, "sessions": [], "past": False, "pinned": {}, "parameters": told} | further


def acting(name: str, chamber: int = -1, parameters: dict[str, float] | None = None, **further: Any) -> dict[str, Any]:
    return entry(name, chamber, **further) | {"parameters": parameters or {}}


def row(name: str, instead_of: str, **further: Any) -> dict[str, Any]:
    return {"name": name, "instead_of": instead_of, "equivalent": True} | further


def found(effects: list[dict[str, Any]], rivals: list[dict[str, Any]]) -> Diagnosis:
    return Diagnosis(
        robot_name="tripod", simulator_name="PccSimulator", verdict="indistinguishable", sentences=[], effects=effects,
        simulator_parameters={}, retuned={}, rivals=rivals, located=[], errors_mm={}, errors_deg={}, unexplained={},
        next_experiment=None, data={},
    )  # fmt: skip


def effects(diagnosis: Diagnosis) -> dict[str, tuple[Any, ...]]:
    return {rival.label: rival.effects for rival in rivals_of((), diagnosis, robot(), body(), 4.0)}


def test_rivals_before_a_gauge_and_behind_a_gate_are_planned_for_as_they_were_fitted() -> None:
    before = {"pinned": {"before_gauge": True}}
    named = entry("knee", 1, {"slope": 0.6, "threshold": 0.7}, **before)
    gated = acting("gain", 1, {"gain": 0.8, "above_share": 0.6})
    lasting = acting("failure", 2, {"loss": 0.3, "onset_s": 40.0}, lasting="ever", pinned={"begun_s": 300.0})
    label = "knee (chamber 2, before the gauge)"
    made = effects(found([named], [
        row("gain (chamber 2, above a pressure)", label, effect=gated, replaces=acting("knee", 1, **before)),
        row("failure (chamber 3, lasting)", label, effect=lasting, replaces=acting("knee", 1, **before)),
        row("play", "knee (chamber 2)", effect=acting("play"), replaces=acting("knee", 1)),
    ]))  # fmt: skip
    assert made == {
        label: (Knee(0.6, 0.7, 1, before_gauge=True),),
        "gain (chamber 2, above a pressure)": (Gain(0.8, 1, above_share=0.6),),
        "failure (chamber 3, lasting)": (Failure(0.3, 40.0, 2, begun_s=300.0),),
    }, "what replaces something that is not named is no rival"


def test_what_is_history_does_nothing_to_the_planned_program() -> None:
    past = {"sessions": ["monday"], "past": True}
    always, monday = acting("payload"), acting("payload", **past)
    open_now = effects(found([entry("payload", parameters={"mass": 0.1})],
                             [row("payload (session monday)", "payload", effect=monday, replaces=always)]))  # fmt: skip
    assert {label: len(made) for label, made in open_now.items()} == {"payload": 1, "payload (session monday)": 0}
    over = found(
        [entry("payload", **past)], [row("lag", "payload (session monday)", effect=acting("lag"), replaces=monday)]
    )
    assert {label: len(made) for label, made in effects(over).items()} == {NOTHING: 0, "lag": 1}
    both = replace(over, rivals=[row("frame", "payload", effect=acting("frame", **past), replaces=monday)])
    with pytest.raises(ConfigError, match=r"no two hypotheses open.*\[lag,nothing\]"):
        effects(both)


def test_labels_are_read_where_a_diagnosis_tells_no_more() -> None:
    old = {"name": "knee", "chamber": -1, "pinned": {"before_gauge": True}, "parameters": {"slope": {"value": 0.6}}}
    assert form_of(old).same_as(form_of_label("knee (before the gauge)"))
    assert not form_of(old).same_as(form_of_label("knee"))
    late = form_of_label("leak (chamber 2, from a time on, behind the gauge)")
    assert (late.chamber, late.values) == (1, {"since_s": 10.0, "behind_gauge": True})
    assert form_of_label("payload (session 2020-09-08)").past
    known = found([entry("knee", parameters={"slope": 0.6}, pinned={"before_gauge": True})],
                  [row("gain (chamber 2, above a pressure)", "knee (before the gauge)")])  # fmt: skip
    assert effects(known)["gain (chamber 2, above a pressure)"] == (Gain(0.8, 1, above_share=0.3),)
