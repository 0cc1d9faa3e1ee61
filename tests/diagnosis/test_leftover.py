"""What is left beside effects that explain most of an error: no reason where it is noise, one where it is structure."""

from types import SimpleNamespace
from typing import Any

import pytest

from softrl.diagnosis import leftover
from softrl.diagnosis.hypothesis import Choice, Hypothesis
from softrl.diagnosis.leftover import Explained, reasons_of


@pytest.mark.parametrize(
    ("name", "of_all", "left", "uneven", "unknown"),
    [
        ("frame", 0.8, 3.0, True, True),
        ("command_map", 0.8, 3.0, True, True),
        ("frame", 0.95, 3.0, True, False),
        ("frame", 0.8, 3.0, False, False),
        ("frame", 0.8, 2.0, True, False),
        ("mullins", 0.8, 3.0, True, False),  # a wall's law may have another form
        ("mullins", 0.7, 3.0, True, True),
    ],
)
def test_structure_that_is_plainly_left_is_told_unless_nearly_all_is_explained(
    name: str, of_all: float, left: float, uneven: bool, unknown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge: Any = SimpleNamespace(material=1.0, thresholds=SimpleNamespace(explained_share=0.75))
    offer: Any = SimpleNamespace(pays=False)
    final: Any = SimpleNamespace(hypothesis=Hypothesis((Choice(name),), ()), squares=None)
    for own, value in (("_drives", []), ("heldout_residual", None), ("_uneven", uneven)):
        monkeypatch.setattr(leftover, own, lambda *_, value=value: value)
    assert bool(reasons_of(judge, final, offer, Explained(0.9, of_all, left))) is unknown
