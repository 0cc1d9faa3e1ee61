"""A pump that all chambers share is told from valves that are slow each by itself, and the other way round."""

import pytest

from softrl.artifacts.diagnosis import Diagnosis
from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.effect import Effect
from softrl.effects.rate_limit import RateLimit
from softrl.effects.shared_flow import SharedFlow
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

pytestmark = pytest.mark.slow
RIVALS = ["shared_flow", "rate_limit", "flow_limit", "lag", "deadband"]


def diagnosed(body: PccSimulator, effect: Effect, measured: bool) -> Diagnosis:
    recordings = made(body, (effect,), measured=measured)
    return run(configured(candidates=RIVALS), body.robot, recordings, body, tracker=NullTracker())


@pytest.mark.parametrize("measured", [True, False])
def test_a_pump_that_chambers_share_is_named(body: PccSimulator, measured: bool) -> None:
    found = diagnosed(body, SharedFlow(rise_per_s=1.5), measured)
    assert [effect["name"] for effect in found.effects] == ["shared_flow"], found.sentences
    assert found.effects[0]["parameters"]["rise_per_s"]["value"] == pytest.approx(1.5, rel=0.03)


def test_valves_that_are_slow_each_by_itself_share_nothing(body: PccSimulator) -> None:
    found = diagnosed(body, RateLimit(rise_per_s=0.8, fall_per_s=0.8), False)
    assert [effect["name"] for effect in found.effects] == ["rate_limit"], found.sentences
