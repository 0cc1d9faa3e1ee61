"""Equilibria along a path of loads: each starts from the one before it, moved along its tangent."""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel, Tangent

log = logging.getLogger(__name__)
REFINEMENTS = (1, 3, 9)  # how much finer the load steps become when an equilibrium is not found


class Cost(NamedTuple):
    """What an equilibrium cost.

    Attributes
    ----------
    iterations, factorisations : over all load steps
    seconds : processor time
    steps_m : largest nodal shift of each iteration of the last load step, m
    """

    iterations: int
    factorisations: int
    seconds: float
    steps_m: tuple[float, ...]


@dataclass(frozen=True)
class Equilibrium:
    """One equilibrium with its tangent, and what it cost.

    Attributes
    ----------
    load : (chambers + 3,) Pa and N
    pose, tangent : where it is and how it answers
    cost : of all its load steps
    """

    load: np.ndarray
    pose: Pose
    tangent: Tangent
    cost: Cost


def follow(
    model: FemModel, loads: np.ndarray, scale: np.ndarray, largest_step: float
) -> Iterator[Equilibrium | None]:
    """Yield the equilibrium of each row of ``loads`` (samples, chambers + 3), or None where it is not found.

    A change of load longer than ``largest_step`` (in units of ``scale``) is divided. After a failure the path
    starts again at rest, which is the equilibrium under no load but the model's weight.
    """
    rest = _rest(model, loads.shape[1])
    here = rest
    for load in loads:
        found = _reach(model, here, load, scale, largest_step)
        if found is None and here is not rest:
            found = _reach(model, rest, load, scale, largest_step)
        if found is None:
            log.warning("no equilibrium found at load %s (Pa, N)", np.array2string(load, precision=4))
        here = found or rest
        yield found


def _rest(model: FemModel, width: int) -> Equilibrium:
    zero = np.zeros(width)
    solve = model.static(zero)
    if not solve.converged:
        raise SolverError(
            f"no equilibrium at rest: Newton stopped after {solve.iterations} iterations with "
            f"{solve.residual_n:.1e} N left; "
            "check the mesh, and the weight against the material's modulus"
        )
    return Equilibrium(zero, solve.pose, model.tangent(solve.pose, zero), Cost(0, 0, 0.0, ()))


def _reach(
    model: FemModel, start: Equilibrium, load: np.ndarray, scale: np.ndarray, largest_step: float
) -> Equilibrium | None:
    distance = float(np.linalg.norm((load - start.load) / scale))
    for refinement in REFINEMENTS:
        count = refinement * max(1, int(np.ceil(distance / largest_step)))
        try:
            return _walk(model, start, load, count)
        except SolverError as failure:
            log.info("%d load steps were too few: %s", count, failure)
    return None


def _walk(model: FemModel, start: Equilibrium, load: np.ndarray, count: int) -> Equilibrium:
    pose, began = start.pose, time.process_time()
    guess = model.coupling.move(pose, start.tangent.change @ (load - start.load) / count)
    iterations, factorisations = 0, 1
    for share in np.arange(1, count + 1) / count:
        solve = model.static(start.load + share * (load - start.load), guess)
        if not solve.converged:
            raise SolverError(f"Newton stopped after {solve.iterations} iterations, {solve.residual_n:.1e} N left")
        iterations, factorisations = iterations + solve.iterations, factorisations + solve.factorisations
        pose = solve.pose
        if share < 1.0:
            guess = model.predict(pose, (load - start.load) / count)
    tangent = model.tangent(pose, load)
    cost = Cost(iterations, factorisations, time.process_time() - began, solve.steps_m)
    return Equilibrium(load, pose, tangent, cost)
