"""The verdict holds what is named to account: a correction that predicts worse than none is no finding."""

from types import SimpleNamespace
from typing import Any

import pytest

from softrl.diagnosis.explain import verdict_of


@pytest.mark.parametrize(
    ("named", "corrected", "verdict"),
    [(True, 1.0, "named"), (True, 4.0, "unknown"), (False, 4.0, "nothing missing")],
)
def test_names_whose_correction_predicts_worse_than_retuning_are_no_verdict(
    named: bool, corrected: float, verdict: str
) -> None:
    finding: Any = SimpleNamespace(named=["lag"] if named else [], unknown=False, rivals=[])
    assert verdict_of([finding], {"noise_floor": 0.1, "retuned": 3.0, "corrected": corrected}) == verdict
