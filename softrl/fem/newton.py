"""Minimisation of an energy over poses: Newton with line search, shifted Hessian, and reused factors that secants correct."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from softrl.core.errors import ConfigError
from softrl.fem.coupling import Coupling, Pose
from softrl.fem.law import STRESS, TANGENT
from softrl.fem.secants import Secants
from softrl.fem.solver import LinearSolver

SUFFICIENT_DECREASE = 1e-4  # Armijo's constant
ROUND_OFF = 1e-10  # share of the energy below which a difference is noise
SHORTEST_STEP = 1e-6
FIRST_SHIFT, LARGEST_SHIFT = 1e-5, 1e2  # share of the Hessian's diagonal


@dataclass(frozen=True)
class NewtonSettings:
    """When a Newton iteration ends, and when it keeps its factors.

    Attributes
    ----------
    tolerance_m : ends once a full step moves no node by more
    max_iterations : then the solve counts as not converged
    reuse_below : the factors are kept as long as each step is shorter than this share of the one before; 0 never
    """

    tolerance_m: float
    max_iterations: int
    reuse_below: float

    def __post_init__(self) -> None:
        if not self.tolerance_m > 0:
            raise ConfigError(f"newton.tolerance_m={self.tolerance_m:g} must be positive")
        if self.max_iterations < 1:
            raise ConfigError(f"newton.max_iterations={self.max_iterations} must be at least 1")
        if not 0.0 <= self.reuse_below < 1.0:
            raise ConfigError(f"newton.reuse_below={self.reuse_below:g} is outside [0, 1)")


class Solve(NamedTuple):
    """The outcome of a minimisation: failure is a value here.

    Attributes
    ----------
    pose : the last pose
    converged : whether the last step was below the tolerance
    iterations, factorisations : counts
    residual_n : largest nodal force out of balance, N
    steps_m : largest nodal shift of each iteration, m
    stable : whether the Hessian factorised last, that is nearest to ``pose``, was positive as it was
    """

    pose: Pose
    converged: bool
    iterations: int
    factorisations: int
    residual_n: float
    steps_m: tuple[float, ...]
    stable: bool

    @property
    def failure(self) -> str:
        """Why it ended at no minimum; nothing where it did.

        The shift of a Hessian that is not positive shortens its steps, so that a short one does not tell of an equilibrium.
        """
        if not self.converged:
            return f"Newton stopped after {self.iterations} iterations, {self.residual_n:.1e} N left"
        return "" if self.stable else "the equilibrium is not stable: its stiffness has a negative pivot"


class Value(NamedTuple):
    """An objective at a pose: energy in J, nodal gradient (nodes, 3) N, node-pair Hessian blocks or None."""

    energy: float
    gradient: np.ndarray
    blocks: np.ndarray | None


Objective = Callable[[Pose, int], Value]


def minimise(
    objective: Objective, start: Pose, coupling: Coupling, solver: LinearSolver, settings: NewtonSettings,
    factors_ready: bool = False, most_factors: int | None = None,
) -> Solve:
    """Return the pose near ``start`` at which ``objective`` has no gradient.

    ``factors_ready`` says that ``solver`` holds the factors of a similar Hessian, to begin with. What needs more than
    ``most_factors``, if given, ends as not converged.
    """
    shifts = 3 * len(coupling.free)
    learnt = Secants(solver)
    pose, value = start, objective(start, STRESS)
    steps: list[float] = []
    factorisations, fresh, reusable, positive = 0, False, factors_ready and settings.reuse_below > 0, True
    previous = np.inf
    residual = coupling.reduce(value.gradient, pose)
    while len(steps) < settings.max_iterations:
        step = -learnt.solve(residual) if reusable else None
        if step is None or np.abs(step[:shifts]).max() > settings.reuse_below * previous:
            if factorisations == most_factors:
                break
            positive = factorise(objective(pose, TANGENT), pose, coupling, solver)
            learnt = Secants(solver)
            step, factorisations, fresh = -learnt.solve(residual), factorisations + 1, True
            reusable = positive and settings.reuse_below > 0
        else:
            fresh = False
        length = float(np.abs(step[:shifts]).max())
        done = length < settings.tolerance_m  # then energies differ by less than round-off: no search
        slope = np.inf if done else float(residual @ step)
        share, pose, value = _search(objective, coupling, pose, value, step, slope)
        before, residual = residual, coupling.reduce(value.gradient, pose)
        learnt.learn(share * step, residual - before)
        steps.append(length)
        if done and share == 1.0:
            return Solve(pose, True, len(steps), factorisations, _largest(residual, shifts), tuple(steps), positive)
        if share == 0.0 and fresh:
            break
        reusable = reusable and share == 1.0
        previous = length if length > 0 else np.inf
    return Solve(pose, False, len(steps), factorisations, _largest(residual, shifts), tuple(steps), positive)


def factorise(value: Value, pose: Pose, coupling: Coupling, solver: LinearSolver) -> bool:
    """Factorise the Hessian, shifted until it is positive; return whether it was so without a shift."""
    assert value.blocks is not None
    matrix = coupling.stiffness(value.blocks, value.gradient, pose)
    if solver.factorise(matrix):
        return True
    diagonal = np.abs(matrix.data[coupling.diagonal])
    diagonal = np.maximum(diagonal, 1e-6 * diagonal.max())
    plain, shift = matrix.data[coupling.diagonal].copy(), FIRST_SHIFT
    while shift <= LARGEST_SHIFT:
        matrix.data[coupling.diagonal] = plain + shift * diagonal
        if solver.factorise(matrix):
            return False
        shift *= 10.0
    matrix.data[:] = 0.0  # steepest descent, scaled: always possible
    matrix.data[coupling.diagonal] = diagonal
    solver.factorise(matrix)
    return False


def _search(
    objective: Objective, coupling: Coupling, pose: Pose, value: Value, step: np.ndarray, slope: float
) -> tuple[float, Pose, Value]:
    """Return (share, pose, value) of the longest halved step that lowers the energy enough; share 0 if none."""
    share = 1.0
    noise = ROUND_OFF * abs(value.energy)
    while share >= SHORTEST_STEP:
        trial = coupling.move(pose, share * step)
        found = objective(trial, STRESS)
        if found.energy <= value.energy + SUFFICIENT_DECREASE * share * slope + noise:
            return share, trial, found
        share *= 0.5
    return 0.0, pose, value


def _largest(residual: np.ndarray, shifts: int) -> float:
    return float(np.abs(residual[:shifts]).max(initial=0.0))
