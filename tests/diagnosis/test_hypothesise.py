"""The search for effects comes to an end."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.fitting.hypothesis import Choice, Hypothesis
from softrl.diagnosis.fitting.minimise import Fit
from softrl.diagnosis.fitting.trial import Trial
from softrl.diagnosis.search import hypothesise
from softrl.diagnosis.search.path import Path

LAG, PLAY = Choice("lag"), Choice("play")


def trial(*effects: Choice) -> Trial:
    return Trial(Hypothesis(effects, ()), Fit(np.zeros(0), np.zeros(0), np.zeros((0, 0)), 1.0, 0), {}, np.ones(4), np.ones(4))


def test_effects_that_drive_each_other_out_are_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pair whose older member goes, whichever it is, would else be made and undone for ever."""
    asked: list[str] = []

    def add(_: Any, __: Any, current: Trial, *___: Any) -> Trial:
        asked.append(current.hypothesis.label())
        return trial(*current.hypothesis.effects, PLAY if current.hypothesis.named("lag") else LAG)

    monkeypatch.setattr(hypothesise, "addition", add)
    monkeypatch.setattr(hypothesise, "pays", lambda *_: True)
    monkeypatch.setattr(hypothesise, "_settled", lambda _, __, added, *___: trial(added.hypothesis.effects[-1]))
    judge: Any = SimpleNamespace(material=0.0, excess=float, rms=lambda squares: 1.0)
    path, told = Path(trial(LAG), trial()), []
    fitting: Any = SimpleNamespace(target="motion")
    search: Any = SimpleNamespace(max_effects=3)
    hypothesise._grow(fitting, judge, (), search, path, told.append)
    assert asked == ["lag", "play"] and "has been here" in told[-1]
