"""A reduced body whose layers are stiffer or softer than the full model's, which costs its steps nothing.

Layers of a wall bear one load in series, so that shares of their compliance add up: with ``s`` times a layer's stiffness the
share is ``g = 1 - c / s``, and ``c`` makes the mean of all shares zero. At the same volumes and tip the body stores, to second
order, ``c (W + g.E + g^2.E - g'G g / 2)``, with E what each layer stores and G how the body gives. Where all layers have one
scale that is exact. Inertia and viscosity stay those of the shapes of before.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.core.errors import ConfigError


class Layered(NamedTuple):
    """What changes with the layers: energy (m,) J, centre of mass (3, m) m, and by how much the tip turns (3, m) rad."""

    energy: np.ndarray
    centre_of_mass: np.ndarray
    turn: np.ndarray


def layered(model: ReducedModel, scales: Sequence[float] | None) -> Layered:
    """Return ``model`` with ``scales`` (layers,) times its layers' stiffness, from below; its own if None.

    Raises
    ------
    ConfigError
        If there are as many scales as the body has no layers, or one is not positive.
    """
    if scales is None:
        return Layered(model.energy, model.centre_of_mass, np.zeros((3, 1)))
    if len(scales) != model.layers or not min(scales) > 0.0:
        raise ConfigError(f"scales of the layers {list(scales)}; expected {model.layers} positive numbers")
    common = len(scales) / np.sum(1.0 / np.asarray(scales, dtype=float))
    share = 1.0 - common / np.asarray(scales, dtype=float)
    rows, columns = np.triu_indices(len(share))
    product = share[rows] * share[columns] * np.where(rows == columns, 0.5, 1.0)
    energy = sum_of(model.energy, sum_of((share + share**2) @ model.layer_energy, -product @ model.layer_give))
    moved, turn = (np.tensordot(share, part.reshape(3, len(share), -1), (0, 1)) for part in (model.layer_drop, model.layer_spin))
    return Layered(common * energy, sum_of(model.centre_of_mass, moved / model.mass), turn)


def sum_of(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the sum of two maps (..., monomials), which may be of different degree."""
    longer, shorter = (left, right) if left.shape[-1] >= right.shape[-1] else (right, left)
    total = np.array(longer, dtype=float)
    total[..., : shorter.shape[-1]] += shorter
    return total
