"""What becomes of a chain of loads: its equilibria as ``Snapshots`` keeps them, or why there is none."""

from typing import NamedTuple

import numpy as np

from softrl.core.resume import pack, unpack
from softrl.fem.answers import Row, answers_at, slopes_at
from softrl.fem.continuation import Cost, Equilibrium, Missed, follow
from softrl.fem.layers import layers_at
from softrl.fem.model import FemModel
from softrl.fem.weight import WEIGHT

SLOPE = "slope/"  # before the name of what changes with the load so
Found = tuple[int, Row, Cost]
Lost = tuple[int, Missed]


class Chain(NamedTuple):
    """What became of the loads of a chain, each with its row number."""

    found: list[Found]
    missed: list[Lost]

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all of it as arrays by name; see ``chain_of``."""
        parts = {n: {f"row/{name}": value for name, value in row.items()} | pack(cost, "cost/") for n, row, cost in self.found}
        parts |= {n: pack(miss, "missed/") for n, miss in self.missed}
        return {f"{n}/{name}": array for n, part in parts.items() for name, array in part.items()}


def chain_of(arrays: dict[str, np.ndarray]) -> Chain:
    """Return the chain that ``Chain.arrays`` took apart."""
    parts: dict[int, dict[str, np.ndarray]] = {}
    for name, array in arrays.items():
        number, rest = name.split("/", 1)
        parts.setdefault(int(number), {})[rest] = array
    chain = Chain([], [])
    for n, part in sorted(parts.items()):
        if "missed/reason" in part:
            chain.missed.append((n, unpack(Missed, part, "missed/")))
        else:
            row = {name.removeprefix("row/"): array for name, array in part.items() if name.startswith("row/")}
            chain.found.append((n, row, unpack(Cost, part, "cost/")))
    return chain


def trace(model: FemModel, loads: np.ndarray, chain: np.ndarray, scale: np.ndarray, longest: float) -> Chain:
    """Return the equilibria of the rows ``chain`` of ``loads``, each from the one before it; see ``fem.continuation``."""
    traced = Chain([], [])
    for number, end in zip(chain, follow(model, loads[chain], scale, longest), strict=True):
        if isinstance(end, Missed):
            traced.missed.append((int(number), end))
        else:
            traced.found.append((int(number), row_of(model, end), end.cost))
    return traced


def row_of(model: FemModel, equilibrium: Equilibrium) -> Row:
    """Return what ``Snapshots`` keeps of an equilibrium; it must be what ``model`` computed last."""
    pose, tangent = equilibrium.pose, equilibrium.tangent
    answers = answers_at(model, pose, tangent, model.solve)
    slopes, by_gravity = slopes_at(model, pose, equilibrium.load, tangent, answers)
    row = {
        "coordinate": model.coordinate(pose),
        "energy": np.asarray(model.elastic_energy(pose)),
        "moments": model.moments(pose.position - model.solid.points),
        "moment_slope": np.moveaxis(model.moments(tangent.shapes), 0, -1),
        "tip_quaternion": model.tip_quaternion(pose),
        "viscosity_by_gravity": by_gravity,
        "displacement": (pose.position - model.solid.points)[: model.solid.corners].astype(np.float32),
    }
    row |= layers_at(model, pose, tangent, answers.forces[:, WEIGHT], model.solve)._asdict()
    return row | answers.row | {SLOPE + name: slope for name, slope in slopes.items()}
