"""What the lumped body's kernel reads of a robot, and the rows of what it works in."""

from typing import Any, NamedTuple

import numpy as np

from softrl.core.compiled import summing
from softrl.pcc.inertia import Inertia


class Model(NamedTuple):
    """A lumped body in its coordinates: five, which are its shape, or two, bend and loss of curvature in one plane.

    Attributes
    ----------
    plane : (2,), that of a body with two coordinates
    stiffness, damping : (m,) J, J s, of each coordinate
    inertia : see ``Inertia``
    skewed, skewed_damping : J and J s, stiffness and damping that they share where the stiffness changes along the body
    push : (stretching, chambers) J/Pa, work of the pressures on the coordinates that stretch chambers
    to_strain : (chambers, stretching), strains of those coordinates
    to_elastic : (chambers, stretching) Pa, pressures that hold them
    slope : (chambers,) Pa, of those by the chamber's own strain
    wall : (chambers,) Pa, stiffness of the wall beside each chamber
    beside : (stretching, stretching) J, stiffness of the body that no chamber feels: of two chambers' out of their plane
    rest : (m,), equilibrium from which strains count
    length, mass, end : m; kg along the body, kg at its tip
    axial_weight : N m, of the elongation, which the length at rest includes
    gravity : (3,) m/s^2
    order : m numbers: how many there are is known when loops over them are compiled
    """

    plane: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    inertia: Inertia
    skewed: float
    skewed_damping: float
    push: np.ndarray
    to_strain: np.ndarray
    to_elastic: np.ndarray
    slope: np.ndarray
    wall: np.ndarray
    beside: np.ndarray
    rest: np.ndarray
    length: float
    mass: float
    end: float
    axial_weight: float
    gravity: np.ndarray
    order: tuple[float, ...]


# rows of the work array that one step fills, m numbers each; FIRST and SECOND have a row of what is foretold behind them
LAST, VELOCITY, TRIAL, RESIDUAL, STEP, OTHER, NEXT, MOVED, SEEN, GAINED, FIRST, _, SECOND, _ = range(14)
WORK_ROWS = 14


@summing
def stretching(model: Any) -> int:
    """Return how many of the coordinates, the first, stretch chambers; the others are losses of curvature."""
    return len(model.order) - len(model.order) // 2


@summing
def fill_shape(model: Any, y: np.ndarray, shape: np.ndarray) -> None:
    """Fill the ``shape`` (b_x, b_y, elongation, c_x, c_y) at the coordinates ``y`` (m,)."""
    if len(model.order) == 5:
        for i in range(5):
            shape[i] = y[i]
        return
    for i in range(2):
        shape[i], shape[3 + i] = model.plane[i] * y[0], model.plane[i] * y[1]
    shape[2] = 0.0
