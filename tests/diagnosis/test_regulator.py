"""A regulator that opens in proportion to its error, and no farther than it can, beside the two laws that it lies between."""

import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.rate_limit import RateLimit
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

pytestmark = pytest.mark.slow
RIVALS = ["lag", "rate_limit", "flow_limit", "orifice", "tube_line", "deadband", "dead_time"]


def diagnosed(body: PccSimulator, effect: Effect, measured: bool) -> Diagnosis:
    recordings = made(body, (effect,), measured=measured)
    return run(configured(candidates=RIVALS), body.robot, recordings, body, tracker=NullTracker())


@pytest.mark.parametrize("measured", [True, False])
def test_both_of_its_numbers_are_found(body: PccSimulator, measured: bool) -> None:
    found = diagnosed(body, RateLimit(rise_per_s=1.8, fall_per_s=1.2, lag_s=0.08), measured)
    assert [effect["name"] for effect in found.effects] == ["rate_limit"], found.sentences
    values = {name: value["value"] for name, value in found.effects[0]["parameters"].items()}
    assert values == pytest.approx({"rise_per_s": 1.8, "fall_per_s": 1.2, "lag_s": 0.08}, rel=0.05)


@pytest.mark.parametrize("effect", [Lag(fill_s=0.2, vent_s=0.2), Lag(fill_s=0.1, vent_s=0.3)], ids=["even", "uneven"])
def test_a_lag_that_nothing_bounds_is_a_lag(body: PccSimulator, effect: Lag) -> None:
    found = diagnosed(body, effect, False)
    assert [one["name"] for one in found.effects] == ["lag"], found.sentences
    assert "rate_limit" not in found.sentences[0]


def test_a_bound_without_a_lag_has_none(body: PccSimulator) -> None:
    found = diagnosed(body, RateLimit(rise_per_s=0.8, fall_per_s=1.6), False)
    assert [one["name"] for one in found.effects] == ["rate_limit"], found.sentences
    assert set(found.effects[0]["parameters"]) == {"rise_per_s", "fall_per_s"}
