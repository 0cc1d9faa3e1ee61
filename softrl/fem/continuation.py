"""Equilibria along a path of loads: each starts from the one before it, moved along its path to second order.

A body that buckles or snaps through has several equilibria under one load, and Newton may leave the branch that
began at rest. An equilibrium therefore counts only where every load step of its path ended at a stable equilibrium
and moved the body as tangent and bend of the path at both its ends say: at the start alone the tangent near a limit
point is long and may happen to point beyond the jump. Otherwise the step is halved, and the load is missed in the end.
"""

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel
from softrl.fem.newton import Solve
from softrl.fem.tangent import Tangent

log = logging.getLogger(__name__)
PARTS = 32  # of a load step: how short it becomes, by halves, where it fails
MOST_HALVINGS = 12  # on one path
PATIENCE = 10  # factorisations after which a step that can be halved is: one that converges takes two or three
DEVIATION = 0.3  # largest share of a step's motion (its largest nodal shift) that the path at an end may miss


class JumpError(SolverError):
    """A load step moved the body otherwise than its tangents said, however short it was: on another branch."""


class Cost(NamedTuple):
    """What an equilibrium cost.

    Attributes
    ----------
    iterations, factorisations : over all load steps
    halvings : how often a load step was halved
    seconds : processor time
    steps_m : largest nodal shift of each iteration of the last load step, m
    """

    iterations: int
    factorisations: int
    halvings: int
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


class Missed(NamedTuple):
    """A load whose equilibrium was not found.

    Attributes
    ----------
    reason : in a line, with the place on the path
    jumped : whether there is an equilibrium, but only behind a jump
    """

    reason: str
    jumped: bool


def follow(
    model: FemModel, loads: np.ndarray, scale: np.ndarray, largest_step: float
) -> Iterator[Equilibrium | Missed]:
    """Yield the equilibrium of each row of ``loads`` (samples, chambers + 3), or why it was not found.

    A change of load longer than ``largest_step`` (in units of ``scale``) is divided. A load that is missed on the way
    from the one before is tried again from rest, which is the equilibrium under no load but the model's weight; the
    path goes on there too.
    """
    rest = _rest(model, loads.shape[1])
    here = rest
    for load in loads:
        found = _reach(model, here, load, scale, largest_step)
        if isinstance(found, Missed) and here is not rest:
            found = _reach(model, rest, load, scale, largest_step)
        if isinstance(found, Missed):
            log.warning("no equilibrium at load %s (Pa, N): %s", told(load), found.reason)
        here = rest if isinstance(found, Missed) else found
        yield found


def _rest(model: FemModel, width: int) -> Equilibrium:
    zero = np.zeros(width)
    solve = model.static(zero)
    if solve.failure:
        raise SolverError(
            f"no equilibrium at rest: {solve.failure}; check the mesh, and the weight against the material's modulus"
        )
    return Equilibrium(zero, solve.pose, model.tangent(solve.pose, zero), Cost(0, 0, 0, 0.0, ()))


def _reach(
    model: FemModel, start: Equilibrium, load: np.ndarray, scale: np.ndarray, largest_step: float
) -> Equilibrium | Missed:
    distance = float(np.linalg.norm((load - start.load) / scale))
    try:
        return _walk(model, start, load, max(1, int(np.ceil(distance / largest_step))))
    except SolverError as failure:
        return Missed(str(failure), isinstance(failure, JumpError))


class Place(NamedTuple):
    """An equilibrium on a path: its pose, first and second derivative of the unknowns along the path, per part of it.

    ``exact`` says whether they are from factors made there.
    """

    pose: Pose
    rate: np.ndarray
    bend: np.ndarray
    exact: bool

    def ahead(self, model: FemModel, parts: float) -> Pose:
        """Return where the body is ``parts`` further, to second order."""
        return model.coupling.move(self.pose, parts * self.rate + 0.5 * parts**2 * self.bend)

    def guesses(self, model: FemModel, parts: float) -> tuple[Pose, Pose]:
        """Return where the body is ``parts`` further to second order, and to first: near a limit point the bend goes astray."""
        return self.ahead(model, parts), model.coupling.move(self.pose, parts * self.rate)


def _walk(model: FemModel, start: Equilibrium, load: np.ndarray, count: int) -> Equilibrium:
    """Go from ``start`` to ``load`` in ``count`` steps; one that fails is halved, later ones double again."""
    began, whole = time.process_time(), PARTS * count
    unit = (load - start.load) / whole
    here = _exact(model, start.pose, start.load, unit)
    iterations, factorisations, halvings = 0, 1, 0
    done, stride = 0, PARTS
    while done < whole:
        ends = start.load + done * unit, start.load + (done + stride) / whole * (load - start.load)
        solve = model.static(ends[1], model.lowest(ends[1], here.guesses(model, stride)), PATIENCE if stride > 1 else None)
        iterations, factorisations = iterations + solve.iterations, factorisations + solve.factorisations
        try:
            _check_solve(solve)
            there = _arrived(model, here, solve.pose, unit, stride)
            if _astray(model, here, there, stride) is not None:  # by tangents as stale as Newton's factors: make new ones
                factorisations += 1 + (not here.exact)
                here = here if here.exact else _exact(model, here.pose, ends[0], unit)
                there = _exact(model, there.pose, ends[1], unit)
                _check_way(model, here, there, stride)
        except SolverError as failure:
            if stride == 1 or halvings == MOST_HALVINGS:
                way = f"between {done / whole:.1%} and {(done + stride) / whole:.1%} of the way"
                raise type(failure)(f"{way} from load {told(start.load)}, {failure}") from failure
            stride, halvings = stride // 2, halvings + 1
            continue
        here, done = there, done + stride
        if stride < PARTS and done % (2 * stride) == 0:
            stride *= 2
    tangent = model.tangent(here.pose, load)
    cost = Cost(iterations, factorisations, halvings, time.process_time() - began, solve.steps_m)
    return Equilibrium(load, here.pose, tangent, cost)


def told(load: np.ndarray) -> str:
    """Return a load in one line, of however many chambers."""
    return np.array2string(load, precision=4, max_line_width=1000)


def _exact(model: FemModel, pose: Pose, load: np.ndarray, unit: np.ndarray) -> Place:
    """Return the place by factors made there."""
    model.refactorise(pose, load)
    rate = model.answer(pose, unit)
    return Place(pose, rate, model.bend(pose, load, rate, unit), True)


def _arrived(model: FemModel, here: Place, pose: Pose, unit: np.ndarray, parts: int) -> Place:
    """Return the place ``parts`` after ``here`` by the factors at hand, its bend that of the cubic through both."""
    rate = model.answer(pose, unit)
    mean = model.coupling.difference(here.pose, pose) / parts
    return Place(pose, rate, (2.0 * here.rate + 4.0 * rate - 6.0 * mean) / parts, False)


def _check_solve(solve: Solve) -> None:
    if solve.failure:
        raise SolverError(solve.failure)


def _check_way(model: FemModel, here: Place, there: Place, stride: int) -> None:
    astray = _astray(model, here, there, stride)
    if astray is not None:
        node, distance = astray
        x, y, z = 1e3 * model.solid.points[node]
        raise JumpError(
            f"the body jumps (snaps through or buckles): the node at ({x:.1f}, {y:.1f}, {z:.1f}) mm moves "
            f"{1e3 * distance:.3g} mm past what the tangent says"
        )


def _astray(model: FemModel, here: Place, there: Place, stride: int) -> tuple[int, float] | None:
    """Return the node that a tangent at either end misses by most and by how many m, or None where that is little."""
    ahead, behind = here.ahead(model, stride).position, there.ahead(model, -stride).position
    missed = np.maximum(np.abs(there.pose.position - ahead), np.abs(here.pose.position - behind)).max(axis=1)
    allowed = DEVIATION * np.abs(there.pose.position - here.pose.position).max() + 10.0 * model.newton.tolerance_m
    worst = int(missed.argmax())
    return None if missed[worst] <= allowed else (worst, float(missed[worst]))
