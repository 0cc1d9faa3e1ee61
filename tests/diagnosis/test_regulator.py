"""A regulator that opens in proportion to its error, and no farther than it can, beside the two laws that it lies between."""

import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.pi_regulator import PiRegulator
from softrl.effects.rate_limit import RateLimit
from softrl.effects.tube_line import TubeLine
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

pytestmark = pytest.mark.slow
RIVALS = ["lag", "rate_limit", "flow_limit", "orifice", "tube_line", "pi_regulator", "deadband", "dead_time"]


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


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize("rate", [1e4, 1.5], ids=["free", "bounded"])
def test_a_regulator_that_overshoots_is_named(body: PccSimulator, rate: float, measured: bool) -> None:
    found = diagnosed(body, PiRegulator(lag_s=0.1, integral_s=0.3, rate_per_s=rate), measured)
    assert [one["name"] for one in found.effects] == ["pi_regulator"], found.sentences
    values = {name: value["value"] for name, value in found.effects[0]["parameters"].items()}
    expected = {"lag_s": 0.1, "integral_s": 0.3} | ({"rate_per_s": rate} if rate < 1e3 else {})
    assert values == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("period_s", "ratio"), [(0.33, 0.15), (1.5, 0.3)])
def test_a_line_that_rings_is_named(body: PccSimulator, period_s: float, ratio: float) -> None:
    found = diagnosed(body, TubeLine(period_s=period_s, damping_ratio=ratio), False)
    assert [one["name"] for one in found.effects] == ["tube_line"], found.sentences
    values = {name: value["value"] for name, value in found.effects[0]["parameters"].items()}
    assert values == pytest.approx({"period_s": period_s, "damping_ratio": ratio}, rel=0.1)
