"""What is read off an equilibrium besides where it is: how it answers its loads and its weight."""

from collections.abc import Callable
from functools import partial
from itertools import permutations
from typing import NamedTuple

import numpy as np

from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel
from softrl.fem.tangent import Tangent
from softrl.fem.weight import WEIGHT, held_of, pull_of, swing_of, viscosity_by_gravity, weight_of

Row = dict[str, np.ndarray]  # of one equilibrium, by the names that ``Snapshots`` has for it


class Answers(NamedTuple):
    """The answers at an equilibrium.

    Attributes
    ----------
    forces : (unknowns, 9) of unit gravity along each axis, and of motions, see ``fem.weight``
    free : (unknowns, 9) to these forces
    gives : (3, nodes, 3) by which shapes the body gives to unit gravity along each axis, volumes and tip held
    row : what ``Snapshots`` keeps of them
    """

    forces: np.ndarray
    free: np.ndarray
    gives: np.ndarray
    row: Row


def answers_at(
    model: FemModel, pose: Pose, tangent: Tangent, solve: Callable[[np.ndarray], np.ndarray]
) -> Answers:
    """Return the answers at an equilibrium, where ``solve`` says how the unknowns answer forces (unknowns, k)."""
    forces = np.hstack([pull_of(model, pose), swing_of(model, pose, tangent)])
    free = solve(forces)
    held = held_of(model, pose, tangent, free)
    weight = weight_of(model, pose, tangent, forces, held)
    row = {
        "compliance": 0.5 * (tangent.compliance + tangent.compliance.T),
        "tangent_stiffness": tangent.stiffness,
        "tangent_mass": tangent.mass,
    }
    gives = np.stack([model.coupling.expand(x, pose) for x in held[:, WEIGHT].T])
    return Answers(forces, free, gives, row | weight._asdict())


def slopes_at(
    model: FemModel, pose: Pose, load: np.ndarray, tangent: Tangent, here: Answers
) -> tuple[Row, np.ndarray]:
    """Return how the answers change with the load, (n + 3, ...) each, by the factors that ``model`` made at ``pose``.

    By differences between ``here`` and equilibria a little further along each column of the tangent. After them comes
    how the viscosity changes with gravity, see ``fem.weight``.
    """
    slopes, bent = [], []
    for column, unit in zip(tangent.change.T, np.eye(len(load)), strict=True):
        near = model.nearby(pose, load, column, unit)
        turned = model.tangent_of(near.pose, near.answer(tangent.change, model.load_directions(near.pose)))
        there = answers_at(model, near.pose, turned, partial(near.answer, here.free))
        slopes.append({name: (there.row[name] - value) / near.part for name, value in here.row.items()})
        bent.append((there.gives - here.gives) / near.part)
    rows = {name: np.array([slope[name] for slope in slopes]) for name in here.row}
    rows["compliance"] = np.mean([rows["compliance"].transpose(order) for order in permutations(range(3))], axis=0)
    return rows, viscosity_by_gravity(model, pose, tangent, here.gives, np.stack(bent))
