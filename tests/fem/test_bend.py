"""The compliance's slope is what the compliances of neighbouring equilibria say."""

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.fem.bend import compliance_slope
from tests.fem.bodies import model_of

LOAD = np.array([1.5e5, -1e4, 2.0, 1.0, -3.0])


def test_the_slope_is_the_difference_of_neighbours(box: Mesh) -> None:
    model = model_of(box)
    pose = model.static(LOAD).pose
    slope = compliance_slope(model, pose, LOAD, model.tangent(pose, LOAD))
    scale = np.array([1e5, 1e5, 3.0, 3.0, 3.0])
    units = scale[:, None, None] * scale[:, None] * scale
    for k, step in enumerate(1e-3 * scale):
        unit = step * np.eye(len(LOAD))[k]
        ends = [LOAD + unit, LOAD - unit]
        there = [model.tangent(model.static(load, pose).pose, load).compliance for load in ends]
        expected = (there[0] - there[1]) / (2.0 * step)
        error = np.abs((slope[k] - expected) * units[k] / scale[:, None]).max(axis=1)
        assert (error < 1e-3 * np.abs(slope * units / scale[:, None]).max(axis=(0, 2))).all(), (k, error)
