"""What is left beside effects that explain most of an error: no reason where it is noise, one where it is structure."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis import leftover
from softrl.diagnosis.hypothesis import Choice, Hypothesis
from softrl.diagnosis.leftover import Explained, reasons_of
from softrl.diagnosis.problem import Residual


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


def test_rare_jumps_are_no_noise_however_white_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    quiet = rng.standard_normal((400, 3))
    jumps = 8.0 * rng.standard_normal((400, 3)) * (rng.random((400, 1)) < 0.03)
    judge: Any = SimpleNamespace(material=0.3, seed=1, rms=lambda squares: float(np.sqrt(np.mean(squares))))
    drives = [rng.standard_normal((400, 2)).cumsum(axis=0)]
    monkeypatch.setattr(leftover, "_slopes", lambda *_: ())
    for run, uneven in ((quiet, False), (quiet + jumps, True)):
        residual = Residual([run], {})
        assert leftover._uneven(judge, None, residual, drives, leftover.UNEVEN_FACTOR) is uneven  # type: ignore[arg-type]
