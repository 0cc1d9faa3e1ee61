"""A load whose weight was retuned away is named once a retuned mass at the end of its range is asked for its reason."""

import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.payload import Payload
from softrl.effects.power_creep import PowerCreep
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

pytestmark = pytest.mark.slow


def test_a_heavy_load_on_a_creeping_wall_is_found_behind_a_mass_at_the_end_of_its_range(body: PccSimulator) -> None:
    heavier = body.with_parameters(mass_scale=1.35)
    recordings = made(heavier, (PowerCreep(share=0.5, exponent=0.15), Payload(mass=1.2)))
    config = configured(candidates=["power_creep", "payload", "marker_offset", "offset", "frame"])
    found = run(config, body.robot, recordings, body, tracker=NullTracker())
    assert sorted(effect["name"] for effect in found.effects) == ["payload", "power_creep"], found.sentences
    load = next(effect for effect in found.effects if effect["name"] == "payload")["parameters"]["mass"]
    assert load["low"] <= 1.2 <= load["high"]
