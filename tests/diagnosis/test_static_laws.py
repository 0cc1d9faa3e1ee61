"""Pressure that stiffens a body as its chambers stretch, and walls of two moduli, are told from other static laws."""

import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.stage import run
from softrl.effects.area_growth import AreaGrowth
from softrl.effects.bimodular import Bimodular
from softrl.effects.effect import Effect
from softrl.effects.lag import Lag
from softrl.effects.locking import Locking
from softrl.effects.strain_softening import StrainSoftening
from softrl.effects.strain_stiffening import StrainStiffening
from softrl.effects.stretch_area import StretchArea
from softrl.pcc.simulator import PccSimulator
from tests.diagnosis.conftest import configured, made

MORE = (StretchArea(1.5), StrainStiffening(0.5), StrainSoftening(2.0), Bimodular(0.4, 0.05))
STATIC = ["stretch_area", "bimodular", "area_growth", "knee", "strain_stiffening", "strain_softening", "locking", "lag"]


@pytest.mark.parametrize(
    "hidden",
    [
        (StretchArea(-3.0), Lag(0.2, 0.3)),
        (AreaGrowth(-0.3),),
        (Locking(4.0, 0.05, 0.05), Lag(0.1, 0.2)),
        *(pytest.param((effect,), marks=pytest.mark.slow) for effect in MORE),
    ],
)
def test_it_is_named_where_it_is_hidden_and_only_there(body: PccSimulator, hidden: tuple[Effect, ...]) -> None:
    settings = configured(candidates=STATIC, search={"keep": 3})
    found = run(settings, body.robot, made(body, hidden, sessions=4), body, tracker=NullTracker())
    assert {effect["name"] for effect in found.effects} == {effect.name() for effect in hidden}, found.sentences
    assert found.errors_mm["heldout"]["corrected"] < 1.1 * found.errors_mm["heldout"]["noise_floor"]
    for effect in hidden:
        if isinstance(effect, StretchArea):
            (told,) = (named["parameters"]["slope"] for named in found.effects if named["name"] == "stretch_area")
            assert told["value"] == pytest.approx(effect.slope, rel=0.03)
