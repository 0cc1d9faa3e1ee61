"""bench=fem: what a step of the full model costs, against the number of unknowns and against scikit-fem."""

import logging
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.bench.figures import draw_scaling
from softrl.bench.reference import Reference
from softrl.bench.watch import Watch, peak_memory_gb
from softrl.core.errors import ConfigError, SolverError
from softrl.core.tracking import Tracker
from softrl.fem.convergence import Study, draw_convergence, study
from softrl.fem.coupling import Pose
from softrl.fem.law import TANGENT
from softrl.fem.material import StableNeoHookean, material_of
from softrl.fem.model import FemModel, State
from softrl.fem.newton import factorise
from softrl.fem.refine import refine
from softrl.fem.simulator import FemSimulator

log = logging.getLogger(__name__)


class Cost(NamedTuple):
    """What a model costs: unknowns, and metrics by name."""

    unknowns: int
    metrics: dict[str, float]


@dataclass(frozen=True)
class FemBench:
    """The full model on the robot's mesh and on finer ones.

    Attributes
    ----------
    simulator : the full model, its settings and its mesh
    pressure_pa : in the first chamber, as a jump
    dt_s : of the steps;  steps : in a timed run, from rest
    mesh_parts : into how many an edge is cut on each finer mesh; each is measured in a process of its own
    reference_steps : of the scikit-fem reference; 0 leaves it out
    convergence_parts : likewise, of three or more meshes, the first its own (1), from which the tip's displacement is
        extrapolated; none leaves it out
    """

    simulator: FemSimulator
    pressure_pa: float
    dt_s: float
    steps: int
    mesh_parts: tuple[int, ...]
    reference_steps: int
    convergence_parts: tuple[int, ...]

    def __post_init__(self) -> None:
        for name in ("pressure_pa", "dt_s", "steps"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"bench.fem.{name}={getattr(self, name):g} must be positive")
        parts = self.convergence_parts
        if parts and (len(parts) < 3 or parts[0] != 1 or list(parts) != sorted(set(parts))):
            raise ConfigError(f"bench.fem.convergence_parts={parts}; expected 1 and two or more rising numbers, or []")

    def measure(self, watch: Watch, seed: int, tracker: Tracker) -> dict[str, float]:
        """Return the metrics; there is nothing random here."""
        unknowns, metrics = self.cost(watch)
        metrics["unknowns"] = unknowns
        metrics["peak_memory_gb"] = self._elsewhere(1, watch).metrics["peak_memory_gb"]
        sizes = [Cost(unknowns, metrics)] + [self._elsewhere(parts, watch) for parts in self.mesh_parts]
        for size in sizes[1:]:
            metrics |= {f"at_{size.unknowns}/{name}": value for name, value in size.metrics.items()}
        if self.reference_steps:
            metrics |= self.against_reference(watch)
        found = self.convergence() if self.convergence_parts else None
        if found is not None:
            metrics |= _distance(found)
            tracker.figure("fem_convergence", draw_convergence({self.simulator.mesh.robot_name: found}))
        if len(sizes) > 1:
            tracker.figure("fem_scaling", draw_scaling([s.unknowns for s in sizes], [s.metrics for s in sizes], found))
        return metrics

    def cost(self, watch: Watch) -> Cost:
        """Return what assembly, factorisation with solution, and a step cost on the simulator's own mesh."""
        model, load = self.simulator.model, self._load
        state = self._moving(model)
        value = model._potential(load)(state.pose, TANGENT)
        right = model.load_directions(state.pose)[:, 0]

        def assemble() -> None:
            assembled = model._potential(load)(state.pose, TANGENT)
            assert assembled.blocks is not None
            model.coupling.stiffness(assembled.blocks, assembled.gradient, state.pose)

        def solve() -> None:
            factorise(value, state.pose, model.coupling, model._solver)
            model._solver.solve(right)

        def steps() -> None:
            model._stepping = 0.0  # the factors are of another matrix now
            self._run(model, self.steps)

        assembly, factor_solve, run = watch.time(assemble, solve, steps)
        metrics = assembly.milliseconds("assembly") | factor_solve.milliseconds("factor_solve")
        metrics |= type(run)(*(seconds / self.steps for seconds in run)).milliseconds("step")
        metrics |= run.rate("steps", self.steps)
        return Cost(model.coupling.unknowns, metrics | {"peak_memory_gb": peak_memory_gb()})

    def against_reference(self, watch: Watch) -> dict[str, float]:
        """Return how much faster a step is than the same step by scikit-fem and SciPy, taken in turns."""
        simulator, model = self.simulator, self.simulator.model
        material = material_of(simulator.law, simulator.moduli_pa, simulator.poisson)
        if not isinstance(material, StableNeoHookean):
            log.warning("no scikit-fem reference: it is written for law=stable_neo_hookean, not %s", simulator.law)
            return {}
        if simulator.element_order != 2 or simulator.youngs_modulus_scale != 1.0:
            log.warning(
                "no scikit-fem reference: it is written for quadratic elements of the modulus as told, not element_order=%d, "
                "youngs_modulus_scale=%g", simulator.element_order, simulator.youngs_modulus_scale,
            )  # fmt: skip
            return {}
        reference, state = Reference(model, watch.now), self._moving(model)
        ended: list[Pose] = []
        parts: list[tuple[float, float]] = []

        def ours() -> None:
            model._stepping = 0.0  # as the reference: no factors to begin with
            ended.append(self._step(model, state).pose)

        def theirs() -> None:
            step = reference.step(state, self._load, self.dt_s)
            ended.append(step.pose)
            parts.append((step.assembly_s, step.solve_s))

        own, other = watch.time(ours, theirs, repeats=self.reference_steps)
        assembly_s, solve_s = np.median(parts, axis=0)
        return {
            **own.milliseconds("cold_step"), **other.milliseconds("scikit_fem_step"),
            "scikit_fem_assembly_ms": 1e3 * float(assembly_s), "scipy_factor_solve_ms": 1e3 * float(solve_s),
            "speedup_vs_scikit_fem": other.median / own.median,
            "scikit_fem_node_difference_mm": 1e3 * float(np.abs(ended[0].position - ended[1].position).max()),
        }  # fmt: skip

    def convergence(self) -> Study:
        """Return how far the pressure moves the tip, without weight, on finer and finer meshes."""
        still = replace(self.simulator.robot, gravity_m_s2=(0.0, 0.0, 0.0))

        def body(mesh: Mesh) -> FemModel:
            return replace(self.simulator, robot=still, mesh=mesh).model

        return study(body, self.simulator.mesh, self._load, self.convergence_parts)

    def _elsewhere(self, parts: int, watch: Watch) -> Cost:
        """Return the cost on the mesh, finer by ``parts``, timed once, in a process of its own: so is its memory."""
        finer = refine(self.simulator.mesh, parts) if parts > 1 else self.simulator.mesh
        bench = replace(self, simulator=replace(self.simulator, mesh=finer), steps=1)
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            return pool.submit(_cost, bench, replace(watch, repeats=1)).result()

    @property
    def _load(self) -> np.ndarray:
        return np.r_[self.pressure_pa, np.zeros(self.simulator.robot.chambers + 2)]

    def _step(self, model: FemModel, state: State) -> State:
        moved, solve = model.step(state, self._load, self.dt_s)
        if solve.failure:
            raise SolverError(f"a step of {self.dt_s:g} s failed, {solve.failure}")
        return moved

    def _run(self, model: FemModel, steps: int) -> State:
        state = model.state()
        for _ in range(steps):
            state = self._step(model, state)
        return state

    def _moving(self, model: FemModel) -> State:
        """Return the body two steps after the pressure's jump: bent, and moving fast."""
        return self._run(model, 2)


def _distance(found: Study) -> dict[str, float]:
    """Return how far the first mesh's tip is from the limit of all, and what each equilibrium took."""
    metrics = {
        "convergence_error_pct": float(found.error_pct[0]),
        "convergence_uncertainty_pct": found.uncertainty_pct,
        "convergence_limit_mm": 1e3 * float(np.linalg.norm(found.limit.value_m)),
        "convergence_order_in_h": found.limit.order,
    }
    for unknowns, tip, seconds in zip(found.unknowns, found.tip_m, found.seconds, strict=True):
        metrics[f"at_{unknowns}/tip_displacement_mm"] = 1e3 * float(np.linalg.norm(tip))
        metrics[f"at_{unknowns}/equilibrium_s"] = float(seconds)
    return metrics


def _cost(bench: FemBench, watch: Watch) -> Cost:
    return bench.cost(watch)
