"""A search ends after so many steps or minutes as it is allowed, and says so."""

import pytest

from softrl.core.errors import ConfigError
from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting import effort
from softrl.diagnosis.stage import run
from softrl.effects.lag import Lag
from softrl.effects.stretch_area import StretchArea
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made


@pytest.mark.parametrize("workers", [1, 2])
def test_steps_are_counted_wherever_they_are_made(workers: int) -> None:
    before = effort.steps
    assert effort.parallel(effort.note, [(2,), (3,)], workers) == [None, None]
    assert effort.steps == before + 5


def test_a_search_that_was_cut_short_says_so(body: PccSimulator) -> None:
    recordings = made(body, (Lag(fill_s=0.2, vent_s=0.3), StretchArea(slope=-6.0)), sessions=3)
    named, told = [], []
    for most in (1, 4e8):
        config = configured(candidates=["lag", "stretch_area", "payload"], search={"steps_lumped": most})
        found = run(config, body.robot, recordings, body, tracker=NullTracker())
        named.append(sorted(effect["name"] for effect in found.effects))
        told.append([line for line in found.data["warnings"] if "after 1 steps" in line and "stage.search.steps" in line])
    assert len(named[0]) == 1 and named[1] == ["lag", "stretch_area"]
    assert len(told[0]) == 1 and not told[1]


def test_a_diagnosis_whose_minutes_are_over_tells_what_was_found_and_that_it_is_not_all(body: PccSimulator) -> None:
    recordings = made(body, (Lag(fill_s=0.2, vent_s=0.3), StretchArea(slope=-6.0)), sessions=3)
    for minutes, verdict in ((1e-6, "unknown"), (60.0, "named")):
        config = configured(candidates=["lag", "stretch_area", "payload"], search={"minutes": minutes})
        found = run(config, body.robot, recordings, body, tracker=NullTracker())
        said = [line for line in found.data["warnings"] if "stage.search.minutes" in line or "stage.search.steps" in line]
        assert found.verdict == verdict and len(said) == (minutes < 1.0)
    with pytest.raises(ConfigError, match=r"stage\.search\.minutes=0"):
        configured(search={"minutes": 0.0})
