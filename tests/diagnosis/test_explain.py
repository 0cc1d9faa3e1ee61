"""The verdict holds what is named to account: a correction that predicts worse than none is no finding."""

from types import SimpleNamespace
from typing import Any

import pytest

from softrl.diagnosis.explain import _at_the_end
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
