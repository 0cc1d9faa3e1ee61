"""What is read off an equilibrium besides where it is: how it answers its loads, its own viscosity and its weight."""

from collections.abc import Callable
from functools import partial
from itertools import permutations
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softrl.fem.coupling import Pose
from softrl.fem.lag import lag_of, push_of
from softrl.fem.model import STEP_M, FemModel, Tangent
from softrl.fem.weight import pull_of, weight_of

Row = dict[str, np.ndarray]  # of one equilibrium, by the names that ``Snapshots`` has for it


class Answers(NamedTuple):
    """The answers at an equilibrium.

    Attributes
    ----------
    free : (unknowns, n + 6) to the viscous force of a unit rate of each coordinate, and to unit gravity along each axis
    row : what ``Snapshots`` keeps of them
    """

    free: np.ndarray
    row: Row


def answers_at(
    model: FemModel, pose: Pose, tangent: Tangent, solve: Callable[[np.ndarray], np.ndarray]
) -> Answers:
    """Return the answers at an equilibrium, where ``solve`` says how the unknowns answer forces (unknowns, k)."""
    push, pull = push_of(model, pose, tangent), pull_of(model, pose)
    free = solve(np.hstack([push, pull]))
    lag = lag_of(model, pose, tangent, push, free[:, : tangent.width])
    weight = weight_of(model, pose, tangent, pull, free[:, tangent.width :])
    row = {
        "compliance": 0.5 * (tangent.compliance + tangent.compliance.T),
        "tangent_stiffness": tangent.stiffness,
        "tangent_mass": tangent.mass,
        "lag_stiffness": lag.stiffness,
        "lag_viscosity": lag.viscosity,
        "lag_spin": lag.spin,
    }
    return Answers(free, row | weight._asdict())


def slopes_at(model: FemModel, pose: Pose, load: np.ndarray, tangent: Tangent, here: Answers) -> Row:
    """Return how the answers change with the load, (n + 3, ...) each, by the factors that ``model`` made at ``pose``.

    An equilibrium a little further along a column of the tangent needs no factors of its own: one correction of the
    answers ``here`` leaves an error of second order in the step.
    """
    slopes = []
    for column, unit in zip(tangent.change.T, np.eye(len(load)), strict=True):
        part = STEP_M / np.abs(column[: 3 * len(model.coupling.free)]).max()
        there = model.coupling.move(pose, part * column)
        corrected = partial(_corrected, model, model.stiffness(there, load + part * unit))
        bent = model.tangent_of(there, corrected(tangent.change, model.load_directions(there)))
        row = answers_at(model, there, bent, partial(corrected, here.free)).row
        slopes.append({name: (row[name] - value) / part for name, value in here.row.items()})
    rows = {name: np.array([slope[name] for slope in slopes]) for name in here.row}
    rows["compliance"] = np.mean([rows["compliance"].transpose(order) for order in permutations(range(3))], axis=0)
    return rows


def _corrected(model: FemModel, upper: sp.csr_matrix, answer: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return how unknowns with the stiffness ``upper`` answer ``forces``, by factors made nearby, where it was ``answer``."""
    resisted = upper @ answer + upper.T @ answer - upper.diagonal()[:, None] * answer
    return answer + model.solve(forces - resisted)
