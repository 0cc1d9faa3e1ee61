"""How a moving body lags behind its equilibria, because its own viscosity pushes it off them.

To the viscous force of a unit rate of coordinate ``i`` the body answers, volumes and tip held, by a shape: lag ``i``,
whose unit is a time times the coordinate's. At rest viscosity is proportional to stiffness and the lags vanish.
"""

from typing import NamedTuple

import numpy as np

from softrl.fem.assembly import multiply_blocks
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel
from softrl.fem.tangent import Tangent


class Lag(NamedTuple):
    """The lags at an equilibrium, one for each of the ``w = n + 3`` coordinates.

    Attributes
    ----------
    stiffness, viscosity : (w, w) of the lags' shapes in the tangent stiffness, and in what stiffness-proportional
        damping multiplies; ``-stiffness`` is also what couples lags and coordinates in the latter
    spin : (3, w) rotation of the plate, rad
    """

    stiffness: np.ndarray
    viscosity: np.ndarray
    spin: np.ndarray


def push_of(model: FemModel, pose: Pose, tangent: Tangent) -> np.ndarray:
    """Return the viscous force (unknowns, w) of a unit rate of each coordinate."""
    return _resist(model, pose, tangent, tangent.change @ np.linalg.inv(tangent.compliance))


def lag_of(model: FemModel, pose: Pose, tangent: Tangent, push: np.ndarray, free: np.ndarray) -> Lag:
    """Return the lags at an equilibrium that answers ``push``, see ``push_of``, by ``free`` (unknowns, w)."""
    plate = model.coupling.body_slice(0)
    held = model.load_directions(pose).T @ free
    lag = tangent.change @ np.linalg.solve(tangent.compliance, held) - free
    stiffness, viscosity = -lag.T @ push, lag.T @ _resist(model, pose, tangent, lag)
    return Lag(
        0.5 * (stiffness + stiffness.T), 0.5 * (viscosity + viscosity.T), lag[plate.start + 3 : plate.stop]
    )


def _resist(model: FemModel, pose: Pose, tangent: Tangent, columns: np.ndarray) -> np.ndarray:
    """Return the viscous forces (unknowns, k) of rates ``columns`` (unknowns, k) of the unknowns."""
    shapes = (model.coupling.expand(column, pose) for column in columns.T)
    forces = (multiply_blocks(tangent.viscous, model.pairs.first, model.pairs.second, shape) for shape in shapes)
    return np.stack([model.coupling.reduce(force, pose) for force in forces], axis=1)
