"""How the answers of an equilibrium change with its load is what neighbouring equilibria say."""

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.fem.answers import Answers, answers_at, slopes_at
from softrl.fem.model import FemModel
from tests.fem.bodies import model_of

LOAD = np.array([1.5e5, -1e4, 2.0, 1.0, -3.0])
SCALE = np.array([1e5, 1e5, 3.0, 3.0, 3.0])


def answers(model: FemModel, load: np.ndarray) -> Answers:
    pose = model.static(load).pose
    return answers_at(model, pose, model.tangent(pose, load), model.solve)


def test_slopes_are_the_differences_of_neighbours(box: Mesh) -> None:
    model = model_of(box)
    pose = model.static(LOAD).pose
    tangent = model.tangent(pose, LOAD)
    slopes, _ = slopes_at(model, pose, LOAD, tangent, answers_at(model, pose, tangent, model.solve))
    expected: dict[str, list[np.ndarray]] = {name: [] for name in slopes}
    for step, unit in zip(1e-3 * SCALE, np.eye(len(LOAD)), strict=True):
        ahead, behind = (answers(model, LOAD + s * step * unit).row for s in (1.0, -1.0))
        for name, values in expected.items():
            values.append((ahead[name] - behind[name]) / (2.0 * step))
    for name, values in expected.items():
        found, scale = np.moveaxis(slopes[name], 0, -1) * SCALE, np.moveaxis(np.array(values), 0, -1) * SCALE
        error = np.abs(found - scale).max(axis=-1)  # entries of different units are judged each by its own
        assert (error < 1e-2 * np.abs(scale).max(axis=-1)).all(), name
