"""The full finite-element body: equilibria, their tangents, and implicit time steps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softrl.artifacts.mesh import PLATE, Mesh
from softrl.core.errors import ConfigError, MeshError, SolverError
from softrl.fem.assembly import ASSEMBLERS, multiply_blocks, node_pairs
from softrl.fem.coupling import Coupling, Pose, quaternion_of
from softrl.fem.damping import viscous, viscous_moduli
from softrl.fem.elements import rigid_bodies, solid_of
from softrl.fem.law import ENERGY, STRESS, TANGENT, VISCOUS
from softrl.fem.loads import VOLUME_RULE, add_volume_gradient, add_volume_stiffness, enclosed_volumes
from softrl.fem.material import Material
from softrl.fem.moments import products
from softrl.fem.newton import NewtonSettings, Objective, Solve, Value, factorise, minimise
from softrl.fem.solver import LinearSolver, linear_solver
from softrl.fem.tangent import Nearby, Tangent

STEP_M = 1e-7  # largest shift of a node in a difference: far above round-off, far below the motion
NO_RUB = np.zeros(3)  # nothing resists a change


@dataclass(frozen=True)
class State:
    """A moving body.

    Attributes
    ----------
    pose : where it is
    velocity : (nodes, 3) m/s
    change : (unknowns,) the last step's change of the unknowns, from which the next step starts
    """

    pose: Pose
    velocity: np.ndarray
    change: np.ndarray


class Step(NamedTuple):
    """A time step: the state after it, and how the solve went."""

    state: State
    solve: Solve


class FemModel:
    """Tetrahedra of one material with rigid plate and ribs, fixed base, pressure in the cavities.

    A load is ``(p_1 .. p_n, F_x, F_y, F_z)``: gauge pressures in Pa, and a force in N on the tip, which is the
    volume centroid of the plate. The mesh is the stress-free shape.

    Parameters
    ----------
    mesh : tetrahedra; their mid-edge nodes are added here
    material : the hyperelastic law
    density_kg_m3 : of the whole mesh, ribs and plate too
    rayleigh_mass_per_s, rayleigh_stiffness_s : damping force (a M + b K(x)) v; K is that of ``fem.damping``, the
        elastic stiffness at rest carried along with the deformation
    newton : settings of the iteration
    gravity_m_s2 : (3,) zero unless given
    stiffness_scale : factor on the elastic energy
    layer_scales : (layers,) further factors, of the layers from below; ones if None
    solver : linear solver; the best one installed if None
    mean_dilatation : changes of volume are weighed by their mean over an element, where the law weighs them by J;
        else at each integration point: stiffer where the material is nearly incompressible, but exact in bending
    element_order : 2, or 1 for linear tetrahedra, which are far too stiff and serve comparisons
    """

    def __init__(
        self, mesh: Mesh, material: Material, density_kg_m3: float, rayleigh_mass_per_s: float,
        rayleigh_stiffness_s: float, newton: NewtonSettings, gravity_m_s2: tuple[float, ...] = (0.0, 0.0, 0.0),
        stiffness_scale: float = 1.0, solver: LinearSolver | None = None, element_order: int = 2,
        mean_dilatation: bool = True, layer_scales: Sequence[float] | None = None,
    ) -> None:
        if density_kg_m3 <= 0:
            raise ConfigError(f"density {density_kg_m3:g} kg/m^3 must be positive")
        if not (mesh.node_region == PLATE).any():
            raise MeshError(f"mesh of {mesh.robot_name} has no plate (node region {PLATE}), so it has no tip")
        self.solid = solid = solid_of(mesh, element_order)
        self.chambers, self.layers, self.newton = mesh.chambers, mesh.layers, newton
        self.rayleigh_mass_per_s, self.rayleigh_stiffness_s = rayleigh_mass_per_s, rayleigh_stiffness_s
        self.nodal_mass = solid.lumped_mass(density_kg_m3)
        self._products = products(solid.points / np.abs(solid.points).max())
        self.gravity_m_s2 = np.array(gravity_m_s2, dtype=float)
        self._material = material
        self._parameters, self._bulk_pa = material.split() if mean_dilatation else (material.pack(), 0.0)
        self._viscous_moduli, self._viscous_bulk = viscous_moduli(material, mean_volume=self._bulk_pa > 0.0)

        region = solid.region[solid.elements]
        deformable = ~((region == region[:, :1]).all(axis=1) & (region[:, 0] != 0))
        self._elements = np.ascontiguousarray(solid.elements[deformable])
        self._gradients = np.ascontiguousarray(solid.gradients[deformable])
        self._layer = mesh.element_layer[deformable]
        stiffer = np.ones(mesh.layers) if layer_scales is None else np.asarray(layer_scales, dtype=float)
        self._weights = np.ascontiguousarray(solid.weights[deformable]) * (stiffness_scale * stiffer[self._layer])[:, None]
        self.pairs = node_pairs(len(solid.points), self._elements, solid.cavity_triangles)
        self.coupling = self._couple()
        self._tip_share = self.coupling.spread(0)[:, None]
        self._solver = solver if solver is not None else linear_solver()
        self._surface = (solid.cavity_triangles, solid.cavity_of_triangle, *VOLUME_RULE[solid.cavity_triangles.shape[1]])
        self._assemble = ASSEMBLERS[solid.elements.shape[1]]
        self._stepping = 0.0  # the time step whose factors the solver holds, s
        self.rest_tip = solid.plate_centroid()
        self.rest_volume = self.volumes(self.rest())

    # what a pose means

    def rest(self) -> Pose:
        """Return the stress-free pose."""
        return self.coupling.rest()

    def volumes(self, pose: Pose) -> np.ndarray:
        """Return the cavity volumes (chambers,) in m^3."""
        return enclosed_volumes(pose.position, *self._surface, self.chambers)

    def tip(self, pose: Pose) -> np.ndarray:
        """Return the tip position (3,) in m."""
        return pose.centre[0].copy()

    def tip_quaternion(self, pose: Pose) -> np.ndarray:
        """Return the plate's orientation relative to rest (4,) w x y z."""
        return quaternion_of(pose.rotation[0])

    def coordinate(self, pose: Pose) -> np.ndarray:
        """Return the coordinate conjugate to a load, (V - V_rest, tip - tip_rest), m^3 and m."""
        return np.r_[self.volumes(pose) - self.rest_volume, self.tip(pose) - self.rest_tip]

    def moments(self, moved: np.ndarray) -> np.ndarray:
        """Return the moments (..., a, 3) kg m of displacements ``moved`` (..., nodes, 3), see ``fem.moments``."""
        return np.asarray(np.einsum("na,...ni->...ai", self.nodal_mass[:, None] * self._products, moved, optimize=True))

    @property
    def moment_gram(self) -> np.ndarray:
        """The products (a, a) kg of the moments' own polynomials, summed over the mass."""
        return np.asarray(self._products.T @ (self.nodal_mass[:, None] * self._products))

    def elastic_energy(self, pose: Pose) -> float:
        """Return the elastic energy above rest in J."""
        return self._elastic(pose, ENERGY).energy

    def elastic_by_layer(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Return each layer's elastic energy (layers,) J above rest, and its gradient (layers, nodes, 3) N."""
        parts = [self._elastic(pose, STRESS, only=self._layer == k) for k in range(self.layers)]
        return np.array([part.energy for part in parts]), np.stack([part.gradient for part in parts])

    # equilibria

    def static(self, load: np.ndarray, start: Pose | None = None, most_factors: int | None = None) -> Solve:
        """Return the equilibrium under ``load`` (chambers + 3,) Pa and N that Newton finds from ``start`` (rest).

        With ``most_factors`` factorisations, if given, it ends, converged or not.
        """
        self._stepping = 0.0
        first = start if start is not None else self.rest()
        return minimise(self._potential(load), first, self.coupling, self._solver, self.newton, most_factors=most_factors)

    def lowest(self, load: np.ndarray, poses: Sequence[Pose]) -> Pose:
        """Return the one of ``poses`` with the least potential under ``load``."""
        potential = self._potential(load)
        return min(poses, key=lambda pose: potential(pose, ENERGY).energy)

    def tangent(self, pose: Pose, load: np.ndarray) -> Tangent:
        """Return the tangent at an equilibrium.

        Raises
        ------
        SolverError
            If the Hessian is not positive: a buckling point, where no tangent exists.
        """
        self.refactorise(pose, load)
        return self.tangent_of(pose, self._solver.solve(self.load_directions(pose)))

    def tangent_of(self, pose: Pose, change: np.ndarray) -> Tangent:
        """Return the tangent at an equilibrium whose unknowns change by ``change`` (unknowns, chambers + 3) with the load."""
        blocks = self.viscous(pose)
        shapes = np.stack([self.coupling.expand(column, pose) for column in change.T])
        stiff = np.stack([multiply_blocks(blocks, self.pairs.first, self.pairs.second, t) for t in shapes])
        return Tangent(
            change, self.load_directions(pose).T @ change, np.einsum("ani,bni->ab", shapes, stiff),
            np.einsum("ani,n,bni->ab", shapes, self.nodal_mass, shapes), shapes, blocks,
        )

    def refactorise(self, pose: Pose, load: np.ndarray) -> None:
        """Let ``solve``, ``answer`` and ``response`` go by the factors at ``pose`` itself.

        Raises
        ------
        SolverError
            If the Hessian is not positive.
        """
        self._stepping = 0.0
        if not factorise(self._potential(load)(pose, TANGENT), pose, self.coupling, self._solver):
            raise SolverError("the equilibrium is not stable: its stiffness has a negative pivot")

    def stiffness(self, pose: Pose, load: np.ndarray) -> sp.csr_matrix:
        """Return the upper triangle of the potential's Hessian in the unknowns."""
        value = self._potential(load)(pose, TANGENT)
        assert value.blocks is not None
        return self.coupling.stiffness(value.blocks, value.gradient, pose)

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Return the answer (unknowns, k) to ``forces`` (unknowns, k) by the factors that the last solve left."""
        return self._solver.solve(forces)

    def answer(self, pose: Pose, load_change: np.ndarray) -> np.ndarray:
        """Return the change (unknowns,) under a small ``load_change``, by the factors that the last solve left."""
        return self._solver.solve(self.load_directions(pose) @ load_change)

    def bend(self, pose: Pose, load: np.ndarray, rate: np.ndarray, load_change: np.ndarray) -> np.ndarray:
        """Return how ``rate``, the ``answer`` to ``load_change``, changes (unknowns,) by that, by factors made at ``pose``."""
        if not rate.any():
            return np.zeros_like(rate)
        near = self.nearby(pose, load, rate, load_change)
        return (near.answer(rate[:, None], self.load_directions(near.pose) @ load_change[:, None])[:, 0] - rate) / near.part

    def nearby(self, pose: Pose, load: np.ndarray, rate: np.ndarray, load_change: np.ndarray) -> Nearby:
        """Return the equilibrium a little from ``pose`` along its ``answer`` ``rate``, not zero, to ``load_change``."""
        part = STEP_M / np.abs(rate[: 3 * len(self.coupling.free)]).max()
        there = self.coupling.move(pose, part * rate)
        return Nearby(there, part, self.stiffness(there, load + part * load_change), self._solver)

    def response(self, pose: Pose) -> np.ndarray:
        """Return d (volumes, tip) / d load (n + 3, n + 3) near ``pose``, by the factors that the last solve left."""
        forces = self.load_directions(pose)
        return forces.T @ self._solver.solve(forces)

    def load_directions(self, pose: Pose) -> np.ndarray:
        """Return the generalised force (unknowns, chambers + 3) of each unit load."""
        columns = np.zeros((self.coupling.unknowns, self.chambers + 3))
        for chamber, unit in enumerate(np.eye(self.chambers)):
            force = np.zeros_like(pose.position)
            add_volume_gradient(pose.position, *self._surface, unit, force)
            columns[:, chamber] = self.coupling.reduce(force, pose)
        plate = self.coupling.body_slice(0)
        columns[plate.start : plate.start + 3, self.chambers :] = np.eye(3)
        return columns

    # motion

    def forget(self) -> None:
        """Let the next step begin with factors of its own, so that it does not depend on the steps before."""
        self._stepping = 0.0

    def state(self, pose: Pose | None = None) -> State:
        """Return the state at rest in ``pose`` (the stress-free one if None)."""
        pose = pose if pose is not None else self.rest()
        return State(pose, np.zeros_like(pose.position), np.zeros(self.coupling.unknowns))

    def step(
        self, state: State, load: np.ndarray, dt: float, gravity_m_s2: np.ndarray | None = None,
        start: Pose | None = None,
    ) -> Step:
        """Return the state ``dt`` seconds later under ``load``, by implicit Euler; Newton begins at ``start``.

        Notes
        -----
        The new nodes x minimise  |x - x_n - dt v_n|_M^2 / (2 dt^2) + a |x - x_n|_M^2 / (2 dt) + b R(x, x_n) / dt + W(x)
        - p.V(x) - F.tip - m g.x  with R half the change of Green's strain squared in the elastic moduli at rest: the
        variational form of implicit Euler with Rayleigh damping, in which a turn costs nothing however far it is. First
        order in ``dt``; it damps motions faster than about 2 pi dt.
        """
        before, extrapolated = state.pose.position, self.coupling.move(state.pose, state.change)
        free_flight = before + dt * state.velocity
        rub = self.rayleigh_stiffness_s / dt * np.array([*self._viscous_moduli, self._viscous_bulk])
        static = self._potential(load, gravity_m_s2, rub, before)
        inertia = self.nodal_mass[:, None] / dt**2
        drag = self.nodal_mass[:, None] * self.rayleigh_mass_per_s / dt

        def objective(pose: Pose, order: int) -> Value:
            energy, gradient, blocks = static(pose, order)
            ahead, moved = pose.position - free_flight, pose.position - before
            push = inertia * ahead + drag * moved
            energy += 0.5 * float((inertia * ahead * ahead).sum() + (drag * moved * moved).sum())
            if blocks is not None:
                blocks[self.pairs.diagonal[:, None], range(3), range(3)] += inertia + drag
            return Value(energy, gradient + push, blocks)

        ready, self._stepping = self._stepping == dt, 0.0
        guesses = (extrapolated, state.pose) if start is None else (start,)
        first = min(guesses, key=lambda pose: objective(pose, ENERGY).energy)
        solve = minimise(objective, first, self.coupling, self._solver, self.newton, ready)
        self._stepping = dt if solve.stable else 0.0  # by factors with a shift steps are short anywhere
        velocity = (solve.pose.position - before) / dt
        return Step(State(solve.pose, velocity, self.coupling.difference(state.pose, solve.pose)), solve)

    def viscous(self, pose: Pose) -> np.ndarray:
        """Return the node-pair blocks of what stiffness-proportional damping multiplies, N/m."""
        blocks = np.zeros((len(self.pairs.first), 3, 3))
        self._assemble(
            viscous, self._viscous_moduli, self._viscous_bulk, NO_RUB, pose.position, pose.position, self._elements,
            self._gradients, self._weights, VISCOUS, self.pairs.element_slots, np.zeros_like(pose.position), blocks,
        )
        return blocks

    # energies

    def _couple(self) -> Coupling:
        q = self.solid
        bodies = rigid_bodies(q.region)
        centres = [q.points[q.region == number].mean(axis=0) for number in bodies]
        centres[0] = q.plate_centroid()  # so that a force on the tip makes no moment
        return Coupling(q.points, q.region, bodies, np.array(centres), self.pairs)

    def _elastic(
        self, pose: Pose, order: int, rub: np.ndarray = NO_RUB, before: np.ndarray | None = None,
        only: np.ndarray | None = None,
    ) -> Value:
        """Return the elastic energy, and what a change from ``before`` costs, with as many derivatives as ``order`` asks.

        ``only`` (elements,) tells of which elements; of all if None.
        """
        gradient = np.zeros_like(pose.position)
        blocks = np.zeros((len(self.pairs.first) if order >= TANGENT else 1, 3, 3))
        parts = (self._elements, self._gradients, self._weights, self.pairs.element_slots)
        elements, gradients, weights, slots = parts if only is None else (part[only] for part in parts)
        energy = self._assemble(
            type(self._material).kernel, self._parameters, self._bulk_pa, rub, pose.position,
            pose.position if before is None else before, elements, gradients, weights, order, slots, gradient, blocks,
        )
        return Value(energy, gradient, blocks if order >= TANGENT else None)

    def _potential(
        self, load: np.ndarray, gravity_m_s2: np.ndarray | None = None, rub: np.ndarray = NO_RUB,
        before: np.ndarray | None = None,
    ) -> Objective:
        """Return W(x) - p.V(x) - F.tip - m g.x as a function of the pose, and what a change from ``before`` costs."""
        pressure = np.ascontiguousarray(load[: self.chambers], dtype=float)
        force = np.asarray(load[self.chambers :], dtype=float)
        gravity = self.gravity_m_s2 if gravity_m_s2 is None else gravity_m_s2
        weight = self.nodal_mass[:, None] * gravity
        spread = self._tip_share

        def objective(pose: Pose, order: int) -> Value:
            energy, gradient, blocks = self._elastic(pose, order, rub, before)
            energy -= float(pressure @ self.volumes(pose) + force @ pose.centre[0] + (weight * pose.position).sum())
            if order >= STRESS:
                push = np.zeros_like(gradient)
                add_volume_gradient(pose.position, *self._surface, pressure, push)
                gradient -= push + weight + spread * force
            if blocks is not None:
                add_volume_stiffness(pose.position, *self._surface, pressure, self.pairs.triangle_slots, blocks)
            return Value(energy, gradient, blocks)

        return objective
