"""What layers have to do with an equilibrium: against bodies whose layers are stiffer, at the same volumes and tip."""

from dataclasses import replace

import numpy as np
import pytest

from softrl.artifacts.mesh import Mesh
from softrl.fem.coupling import Pose
from softrl.fem.layers import Layers, layers_at
from softrl.fem.model import FemModel
from softrl.fem.weight import pull_of
from tests.fem.bodies import hollow_box, model_of

LOAD = np.array([1.5e5, -1e4, 2.0, 1.0, -3.0])
LAYERS = 3


@pytest.fixture(scope="module")
def tall() -> Mesh:
    box = hollow_box(chambers=2)
    height = box.points[box.tetrahedra, 2].mean(axis=1)
    return replace(box, element_layer=np.digitize(height, np.linspace(0.0, box.points[:, 2].max(), LAYERS + 1)[1:-1]))


def told(model: FemModel, pose: Pose) -> Layers:
    tangent = model.tangent(pose, LOAD)
    return layers_at(model, pose, tangent, pull_of(model, pose), model.solve)


def held_at(model: FemModel, wanted: np.ndarray, start: Pose) -> Pose:
    """Return the equilibrium with the volumes and the tip ``wanted``."""
    load, pose = LOAD, start
    for _ in range(8):
        pose = model.static(load, pose).pose
        load = load + np.linalg.solve(model.tangent(pose, load).compliance, wanted - model.coordinate(pose))
    return pose


def test_layers_store_what_the_body_stores_and_their_slopes_are_those_of_neighbours(tall: Mesh) -> None:
    model = model_of(tall)
    pose = model.static(LOAD).pose
    here = told(model, pose)
    assert here.layer_energy.sum() == pytest.approx(model.elastic_energy(pose), rel=1e-10)
    for k, step in enumerate((200.0, 200.0, 0.02, 0.02, 0.02)):
        nudge = step * np.eye(5)[k]
        ends = [model.elastic_by_layer(model.static(LOAD + sign * nudge).pose)[0] for sign in (1.0, -1.0)]
        change = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(here.layer_slope[:, k], change, atol=2e-3 * np.abs(change).max())


def test_one_scale_for_all_layers_leaves_the_shape(tall: Mesh) -> None:
    here = told(model := model_of(tall), model.static(LOAD).pose)
    for part in (here.layer_give, here.layer_drop, here.layer_spin):
        assert np.abs(part.sum(axis=-1)).max() < 1e-6 * np.abs(part).max()


@pytest.mark.parametrize("layer", range(LAYERS))
def test_a_stiffer_layer_gives_what_was_told(tall: Mesh, layer: int) -> None:
    """Energy to second order, centre of mass and turn of the plate to first, at the same volumes and tip."""
    model, step = model_of(tall), 0.02
    pose = model.static(LOAD).pose
    here, wanted, unit = told(model, pose), model.coordinate(pose), step * np.eye(LAYERS)[layer]
    bodies = [model_of(tall, layer_scales=tuple(1.0 + sign * unit)) for sign in (1.0, -1.0)]
    poses = [held_at(body, wanted, pose) for body in bodies]
    energy = np.array([body.elastic_energy(at) for body, at in zip(bodies, poses, strict=True)])
    assert (energy[0] - energy[1]) / (2.0 * step) == pytest.approx(here.layer_energy[layer], rel=1e-3)
    give = (2.0 * model.elastic_energy(pose) - energy.sum()) / step**2
    assert give == pytest.approx(here.layer_give[layer, layer], rel=0.02)
    moved = [model.moments(at.position - model.solid.points)[0] for at in poses]
    np.testing.assert_allclose((moved[0] - moved[1]) / (2.0 * step), here.layer_drop[:, layer],
                               atol=5e-3 * np.abs(here.layer_drop).max())  # fmt: skip
    turn = poses[0].rotation[0] @ poses[1].rotation[0].T
    spin = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (2.0 * step)
    np.testing.assert_allclose(spin, here.layer_spin[:, layer], atol=5e-3 * np.abs(here.layer_spin).max())
