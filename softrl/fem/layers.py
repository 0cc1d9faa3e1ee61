"""What each layer of the wall has to do with an equilibrium: its share of the energy, and how the body gives where it softens.

A layer that is ``s`` times as stiff as the model's has ``s`` times its energy in the same shape, and the body gives to that by
shapes in which volumes and tip stay. Both are first derivatives of the nodes: no sample needs another equilibrium.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel
from softrl.fem.tangent import Tangent
from softrl.fem.weight import held_of


class Layers(NamedTuple):
    """The layers of the wall at an equilibrium under ``w = n + 3`` loads, from below.

    Attributes
    ----------
    layer_energy : (layers,) J, above rest
    layer_slope : (layers, w) d ``layer_energy`` / d load, J per Pa and N
    layer_give : (layers, layers) J; twice the energy that the body loses as it gives to layers stiffer by shares ``d`` of
        their stiffness, volumes and tip held, is ``d' layer_give d``
    layer_drop : (3, layers) kg m, by which mass times centre of mass moves then, and layer_spin : (3, layers) rad, by which
        the plate turns, each per such a share
    """

    layer_energy: np.ndarray
    layer_slope: np.ndarray
    layer_give: np.ndarray
    layer_drop: np.ndarray
    layer_spin: np.ndarray


def layers_at(
    model: FemModel, pose: Pose, tangent: Tangent, pull: np.ndarray, solve: Callable[[np.ndarray], np.ndarray]
) -> Layers:
    """Return what the layers have to do with an equilibrium, where ``solve`` says how the unknowns answer forces (unknowns, k).

    ``pull`` (unknowns, 3) is the force of unit gravity, see ``fem.weight.pull_of``.
    """
    energy, gradients = model.elastic_by_layer(pose)
    forces = np.stack([model.coupling.reduce(gradient, pose) for gradient in gradients], axis=1)
    held = held_of(model, pose, tangent, solve(forces))
    give, plate = forces.T @ held, model.coupling.body_slice(0)
    spin = slice(plate.start + 3, plate.stop)
    return Layers(energy, forces.T @ tangent.change, 0.5 * (give + give.T), -pull.T @ held, -held[spin])
