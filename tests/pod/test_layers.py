"""A body with other layers: exact where all have one scale, to third order where they bear a load in series."""

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.errors import ConfigError
from softrl.core.polynomial import basis, degree_of
from softrl.core.simulator import Motion
from softrl.effects.chain import Plant, chain_of
from softrl.effects.layer_stiffness import LayerStiffness
from softrl.pcc.simulator import PccSimulator
from softrl.pod.simulator import RomSimulator
from softrl.pod.step.layers import layered
from softrl.robots.robot import Robot
from tests.pod.synthetic import LAYERS, law_of

Body = tuple[Robot, Snapshots, ReducedModel]


def at_samples(body: Body, coefficients: np.ndarray) -> np.ndarray:
    _, snapshots, model = body
    y = np.linalg.solve(model.frame, snapshots.coordinate.T).T
    return basis(model.order, degree_of(model.order, coefficients.shape[-1])).values(y) @ coefficients.T


def test_one_scale_is_a_stiffer_body(tripod: Body) -> None:
    model = tripod[2]
    energy, centre, turn = layered(model, (1.7, 1.7, 1.7))
    np.testing.assert_allclose(energy[: len(model.energy)], 1.7 * model.energy, rtol=1e-12)
    np.testing.assert_allclose(centre[:, : model.centre_of_mass.shape[1]], model.centre_of_mass, atol=1e-15)
    assert not turn.any()


@pytest.mark.parametrize("scales", [(0.7, 1.0, 1.0), (1.0, 1.5, 1.0), (1.2, 1.0, 0.8)])
def test_layers_in_series_add_their_compliances(tripod: Body, scales: tuple[float, ...]) -> None:
    expected = tripod[1].energy / np.sum(LAYERS / np.array(scales))
    first_order = tripod[1].energy * (LAYERS @ scales)
    told = at_samples(tripod, layered(tripod[2], scales).energy)
    np.testing.assert_allclose(told, expected, atol=6e-3 * expected.max())
    assert np.abs(told - expected).max() < 0.2 * np.abs(first_order - expected).max()


def test_the_tip_turns_and_the_weight_moves_with_the_layers(tripod: Body) -> None:
    _, snapshots, model = tripod
    scales = (1.0 / 0.9, 1.0 / 1.1, 1.0)  # shares 0.1, -0.1, 0
    _, centre, turn = layered(model, scales)
    moved = at_samples(tripod, centre) - at_samples(tripod, model.centre_of_mass)
    np.testing.assert_allclose(moved, 0.08 * snapshots.moments[:, 0] / model.mass, atol=8e-5)
    turned = np.array([law_of(tripod[0]).rotation(z) for z in snapshots.coordinate])
    np.testing.assert_allclose(at_samples(tripod, turn), 0.08 * turned, atol=1e-3 * np.abs(turned).max())


def test_a_body_without_these_layers_refuses(tripod: Body) -> None:
    robot, _, model = tripod
    with pytest.raises(ConfigError, match="expected 3 positive numbers"):
        layered(model, (1.0, 1.0))
    with pytest.raises(ConfigError, match="expected 3 positive numbers"):
        layered(model, (1.0, 0.0, 1.0))
    lumped = PccSimulator(robot, 0.6, 0.1, 1.0, 1.0, 0.05, 1.0)
    with pytest.raises(ConfigError, match="layer_stiffness needs a body with layers, which PccSimulator has not"):
        motion(lumped, LayerStiffness(scale=0.7, height_share=0.5))


def motion(simulator: RomSimulator | PccSimulator, *effects: LayerStiffness) -> Motion:
    time = 0.01 * np.arange(1, 101)
    pressure = np.outer(np.minimum(time / 0.3, 1.0), [2e4, 0.0, 1e4])
    return Plant(simulator, chain_of(simulator.robot, effects)).simulate(time, pressure)


def test_as_an_effect_it_softens_the_body(tripod: Body) -> None:
    robot, _, model = tripod
    simulator = RomSimulator(robot, model, 1.0, 1.0, 1.0)
    bare = motion(simulator)
    for height in (0.0, 0.5, 1.0):
        np.testing.assert_array_equal(motion(simulator, LayerStiffness(scale=1.0, height_share=height)).position,
                                      motion(simulator.with_layers((1.0, 1.0, 1.0))).position)  # fmt: skip
    rest = simulator.observe(simulator.reset())[0]
    soft = motion(simulator, LayerStiffness(scale=0.6, height_share=0.0)).position[-1] - rest
    stiff = motion(simulator, LayerStiffness(scale=2.0, height_share=0.0)).position[-1] - rest
    plain = bare.position[-1] - rest
    assert np.linalg.norm(soft) > 1.1 * np.linalg.norm(plain) > 1.2 * np.linalg.norm(stiff)
    np.testing.assert_allclose(motion(simulator.with_layers((1.0, 1.0, 1.0))).position, bare.position, atol=1e-9)
