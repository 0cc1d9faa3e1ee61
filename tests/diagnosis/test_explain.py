"""The verdict holds what is named to account: a correction that predicts worse than none is no finding."""

from types import SimpleNamespace
from typing import Any

import pytest

from softrl.diagnosis.explain import _at_the_end, _but, _ungauged
from softrl.diagnosis.hypothesis import Choice
from softrl.diagnosis.parameters import effect_sentence
from softrl.diagnosis.verdict import verdict_of


@pytest.mark.parametrize(
    ("named", "corrected", "verdict"),
    [(True, 1.0, "named"), (True, 4.0, "unknown"), (False, 4.0, "nothing missing")],
)
def test_names_whose_correction_predicts_worse_than_retuning_are_no_verdict(
    named: bool, corrected: float, verdict: str
) -> None:
    finding: Any = SimpleNamespace(named=["lag"] if named else [], unknown=False, rivals=[])
    assert verdict_of([finding], {"noise_floor": 0.1, "retuned": 3.0, "corrected": corrected}) == verdict


def test_parameters_that_the_correction_too_drives_to_an_end_are_told() -> None:
    entry = {"nominal": 2.0, "factor_allowed": 4.0}
    made: Any = SimpleNamespace(
        retuned={"mass_scale": entry, "damping_s": entry, "stiffness_scale": entry},
        simulator_parameters={"mass_scale": 0.5, "damping_s": 2.1, "stiffness_scale": 8.0},
    )
    assert _at_the_end(made) == ["mass_scale", "stiffness_scale"]


def test_a_valve_without_a_gauge_behind_it_may_lie_elsewhere() -> None:
    def finding(*names: str) -> Any:
        return SimpleNamespace(named=[SimpleNamespace(choice=Choice(name)) for name in names])

    assert "may as well lie between pressure and force" in _ungauged([finding("deadband")])[0]
    assert not _ungauged([finding("payload")])
    assert not _ungauged([finding("deadband"), finding("payload")])  # valve and body apart: a gauge stands between


def test_nothing_missing_says_what_stays_beyond_a_detail_of_the_body() -> None:
    def finding(left: float) -> Any:
        return SimpleNamespace(left=left, judge=SimpleNamespace(material=1.0))

    assert "no test tells" in _but([finding(2.5)], "nothing missing")
    assert not _but([finding(1.5)], "nothing missing") and not _but([finding(2.5)], "unknown")


@pytest.mark.parametrize(
    ("name", "parameter", "unit", "told"),
    [("deadband", "band", "1", "= 1.05 kPa"), ("rate_limit", "rise_per_s", "1/s", "1/s = 1.05 kPa/s"),
     ("payload", "mass", "1", "= 3 g"), ("contact", "distance", "1", "= 6 mm")],
)  # fmt: skip
def test_shares_are_told_in_units_of_the_robot(name: str, parameter: str, unit: str, told: str) -> None:
    robot: Any = SimpleNamespace(pressure_max_pa=35e3, length_m=0.2, mass_kg=0.1)
    entry = {"value": 0.03, "low": 0.02, "high": 0.04, "unit": unit, "at_bound": False}
    effect = {"name": name, "site": "valve", "where": "all", "parameters": {parameter: entry}, "evidence": "so"}
    assert f"{parameter} 0.03 (0.02 to 0.04)" in effect_sentence(effect, robot) and told in effect_sentence(effect, robot)
