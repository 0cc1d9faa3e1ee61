"""A body with layers: which of them is soft is told by how far the tip turns for how far it moves."""

import pytest

from softrl.core.tracking import NullTracker
from softrl.diagnosis.fitting.choices import candidates
from softrl.diagnosis.stage import run
from softrl.effects.effect import SITES
from softrl.effects.layer_stiffness import LayerStiffness
from softrl.pcc.simulator import PccSimulator
from softrl.pod.simulator import RomSimulator
from tests.diagnosis.conftest import configured, made
from tests.pod.conftest import fitted

RIVALS = ["layer_stiffness", "stiffness_scale", "gain", "payload", "lag"]


def test_a_soft_layer_is_named_and_found() -> None:
    robot, _, model = fitted(3)
    body = RomSimulator(robot, model, 1.0, 1.0, 1.0)
    hidden = body.with_parameters(youngs_modulus_scale=1.1, damping_scale=0.9)
    recordings = made(hidden, (LayerStiffness(scale=0.5, height_share=0.0),), sessions=4, noise_m=3e-5)
    found = run(configured(candidates=RIVALS, orientation=True), robot, recordings, body, tracker=NullTracker())
    assert found.verdict == "named", found.sentences
    (effect,) = found.effects
    assert effect["name"] == "layer_stiffness" and effect["where"] == "one layer"
    assert effect["parameters"]["scale"]["value"] == pytest.approx(0.5, abs=0.1)
    assert effect["parameters"]["height_share"]["value"] < 0.2


def test_of_a_body_without_layers_nobody_asks(body: PccSimulator) -> None:
    asked = candidates(RIVALS, SITES, body.robot, [0, 1, 2])
    assert "layer_stiffness" not in {choice.name for choice in asked}
    assert "layer_stiffness" in {choice.name for choice in candidates(RIVALS, SITES, body.robot, [0, 1, 2], layers=True)}
