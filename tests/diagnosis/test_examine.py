"""A rival takes an effect's place where all runs that no fit saw agree on it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.examine import Rival, _better
from softrl.diagnosis.hypothesis import Choice
from softrl.diagnosis.judge import Gap


def rival(name: str, value: float, high: float, everywhere: float) -> Any:
    trial = SimpleNamespace(everywhere=np.full(5, everywhere))
    return Rival(Choice("mullins"), Choice(name), Gap(value, 2.0 * value - high, high), True, trial)


@pytest.mark.parametrize(
    ("rivals", "taken"),
    [
        ([rival("lag", -1.0, -0.2, 0.9), rival("creep", -2.0, -0.4, 0.8)], "creep"),
        ([rival("creep", -2.0, -0.4, 1.2)], None),  # worse where the fits were left out in turn
        ([rival("creep", -2.0, 0.1, 0.5)], None),  # perhaps no better
        ([], None),
    ],
)
def test_only_what_is_better_for_sure_and_everywhere_is_taken(rivals: list[Any], taken: str | None) -> None:
    finding: Any = SimpleNamespace(rivals=rivals, final=SimpleNamespace(everywhere=np.ones(5)))
    better = _better(finding)
    assert (better.choice.name if better else None) == taken
