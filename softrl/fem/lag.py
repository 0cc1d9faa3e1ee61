"""How a moving body lags behind its equilibria, because its own viscosity pushes it off them.

To the viscous force of a unit rate of coordinate ``i`` the body answers, volumes and tip held, by a shape: lag ``i``,
whose unit is a time times the coordinate's. At rest viscosity is proportional to stiffness and the lags vanish.
"""

from typing import NamedTuple

import numpy as np

from softrl.fem.assembly import multiply_blocks
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel, Tangent


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


def lag_at(model: FemModel, pose: Pose, tangent: Tangent, blocks: np.ndarray) -> Lag:
    """Return the lags at an equilibrium; ``tangent`` must be what ``model`` computed last, ``blocks`` are its ``viscous``."""
    coupling, pairs, plate = model.coupling, model.pairs, model.coupling.body_slice(0)

    def resist(columns: np.ndarray) -> np.ndarray:
        shapes = (coupling.expand(column, pose) for column in columns.T)
        forces = [multiply_blocks(blocks, pairs.first, pairs.second, shape) for shape in shapes]
        return np.stack([coupling.reduce(force, pose) for force in forces], axis=1)

    push = resist(tangent.change @ np.linalg.inv(tangent.compliance))
    free = model.solve(push)
    held = model.load_directions(pose).T @ free
    lag = tangent.change @ np.linalg.solve(tangent.compliance, held) - free
    stiffness, viscosity = -lag.T @ push, lag.T @ resist(lag)
    return Lag(
        0.5 * (stiffness + stiffness.T), 0.5 * (viscosity + viscosity.T), lag[plate.start + 3 : plate.stop]
    )
