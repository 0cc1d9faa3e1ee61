"""The same time step by scikit-fem's assembly and SciPy's factorisation: what a careful script would cost."""

import importlib
import importlib.util
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrl.core.errors import ConfigError, SolverError
from softrl.fem.coupling import Pose
from softrl.fem.loads import USED_TRIPLES, WEIGHTS, add_volume_gradient, add_volume_stiffness
from softrl.fem.model import FemModel, State


class ReferenceStep(NamedTuple):
    """The pose after a step, Newton iterations, and seconds spent in assembly and in factorisation with solution."""

    pose: Pose
    iterations: int
    assembly_s: float
    solve_s: float


class Reference:
    """Quadratic tetrahedra of ``model``, which is of the stable Neo-Hookean law, in scikit-fem.

    Notes
    -----
    Elastic forces and stiffness are scikit-fem forms over the same elements and Gauss points; rigid bodies are a sparse
    map from unknowns to nodes, factors come from SuperLU in its symmetric mode with the ordering that suits it. Pressure,
    which is cheap, is taken from the model itself. Newton's method without a line search, each step a fresh matrix.
    """

    def __init__(self, model: FemModel, now: Callable[[], float] = time.perf_counter) -> None:
        if importlib.util.find_spec("skfem") is None:
            raise ConfigError("bench=fem compares with scikit-fem; install it with pip install 'softrl[bench]'")
        self._fem: Any = importlib.import_module("skfem")
        self._help: Any = importlib.import_module("skfem.helpers")
        self.model, self._now = model, now
        # the law's own parameters, and the modulus that weighs the mean change of volume of an element, if any
        self._lame, self._bulk = model._parameters, model._bulk_pa
        self._viscous, self._viscous_bulk = model._viscous_moduli, model._viscous_bulk
        solid = model.solid
        corners = solid.elements[:, :4]
        region = solid.region[solid.elements]
        deformable = np.flatnonzero(~((region == region[:, :1]).all(axis=1) & (region[:, 0] != 0)))
        mesh = self._fem.MeshTet(solid.points[: solid.corners].T.copy(), corners.T.copy())
        element = self._fem.ElementVector(self._fem.ElementTetP2())
        self.basis = self._fem.Basis(mesh, element, intorder=2, elements=deformable)
        self._mean = self._fem.Basis(mesh, self._fem.ElementTetP0(), intorder=2, elements=deformable)
        self._volume = self.basis.dx.sum(axis=1)
        self._elements = deformable
        self.rows = self._rows(mesh)
        self._forms()
        self._begin(solid.points, 0.0)

    def step(self, state: State, load: np.ndarray, dt: float) -> ReferenceStep:
        """Return the pose ``dt`` seconds after ``state`` under ``load``: the objective of ``FemModel.step``."""
        model, coupling = self.model, self.model.coupling
        before, flight = state.pose.position, state.pose.position + dt * state.velocity
        spent = {"assembly": 0.0, "solve": 0.0}
        began = self._now()
        self._begin(before, model.rayleigh_stiffness_s / dt)
        inertia = np.repeat(model.nodal_mass, 3) * (1.0 / dt**2 + model.rayleigh_mass_per_s / dt)
        lumped = sp.diags(self._ordered(inertia))
        spent["assembly"] += self._now() - began
        pose = coupling.move(state.pose, state.change)
        for iteration in range(1, model.newton.max_iterations + 1):
            began = self._now()
            gradient = self._gradient(pose, load, dt, before, flight)
            residual = coupling.reduce(gradient, pose)
            matrix = self.stiffness(pose.position) + lumped - self._pressure_stiffness(pose, load)
            reduced = self._reduced(matrix, gradient, pose)
            middle = self._now()
            factors = splu(reduced, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            change = -factors.solve(residual)
            ended = self._now()
            spent["assembly"] += middle - began
            spent["solve"] += ended - middle
            pose = coupling.move(pose, change)
            if np.abs(change[: 3 * len(coupling.free)]).max() < model.newton.tolerance_m:
                return ReferenceStep(pose, iteration, spent["assembly"], spent["solve"])
        raise SolverError(f"the reference step of {dt:g} s did not converge in {model.newton.max_iterations} iterations")

    def _begin(self, before: np.ndarray, rate: float) -> None:
        """Hold what viscosity of ``rate`` 1/s counts a change from: the nodes ``before`` (nodes, 3) m."""
        self._past, self._rate = self.basis.interpolate(self._vector(before)), rate
        self._swept_before = (self._help.det(self._help.grad(self._past)) * self.basis.dx).sum(axis=1)

    def stiffness(self, position: np.ndarray) -> sp.csr_matrix:
        """Return the elastic and viscous stiffness at nodes ``position`` (nodes, 3) m in scikit-fem's order."""
        x = self.basis.interpolate(self._vector(position))
        if not self._bulk:
            return self._stiffness.assemble(self.basis, x=x, past=self._past, push=0.0, rate=self._rate)
        push, swell = self._dilatation(x)
        weight = sp.diags((self._bulk + self._rate * self._viscous_bulk) / self._volume)
        plain = self._stiffness.assemble(self.basis, x=x, past=self._past, push=push[:, None], rate=self._rate)
        return plain + swell.T @ weight @ swell

    def force(self, position: np.ndarray) -> np.ndarray:
        """Return the elastic and viscous forces (nodes, 3) N at nodes ``position`` (nodes, 3) m."""
        x = self.basis.interpolate(self._vector(position))
        push = self._dilatation(x)[0][:, None] if self._bulk else 0.0
        return self._force.assemble(self.basis, x=x, past=self._past, push=push, rate=self._rate)[self.rows]

    def _dilatation(self, x: Any) -> tuple[np.ndarray, sp.csr_matrix]:
        """Return the pressure (elements,) Pa of the mean change of volume, and d volume / d nodes (elements, dofs)."""
        swept = (self._help.det(self._help.grad(x)) * self.basis.dx).sum(axis=1)
        swell = self._swell.assemble(self.basis, self._mean, x=x).tocsr()[self._elements]
        late = self._rate * self._viscous_bulk * (swept - self._swept_before) / self._volume
        return self._bulk * (swept / self._volume - 1.0) + late, swell

    def _forms(self) -> None:
        fem, ddot, det, inv = self._fem, self._help.ddot, self._help.det, self._help.inv
        grad, mul, trace, transpose = self._help.grad, self._help.mul, self._help.trace, self._help.transpose
        lam, mu = self._lame
        first, second = self._viscous

        def strain(slope: Any, f: Any) -> Any:
            product = mul(transpose(f), slope)
            return 0.5 * (product + transpose(product))

        def stress(f: Any, past: Any) -> Any:
            change = 0.5 * (mul(transpose(f), f) - mul(transpose(past), past))
            return first * trace(change) * self._help.eye(np.ones_like(f[0, 0]), 3) + 2.0 * second * change

        @fem.BilinearForm
        def stiffness(u: Any, v: Any, w: Any) -> Any:
            f = grad(w["x"])
            j, inverse = det(f), inv(f)
            slope = (lam + mu) * (j - 1.0) - mu + w["push"]
            a, b = mul(inverse, grad(u)), mul(inverse, grad(v))
            ta, tb = trace(a), trace(b)
            bent = j * (ta * tb - ddot(a, transpose(b)))
            ue, ve = strain(grad(u), f), strain(grad(v), f)
            rub = first * trace(ue) * trace(ve) + 2.0 * second * ddot(ue, ve)
            rub = rub + ddot(stress(f, grad(w["past"])), mul(transpose(grad(u)), grad(v)))
            return mu * ddot(grad(u), grad(v)) + (lam + mu) * j**2 * ta * tb + slope * bent + w["rate"] * rub

        @fem.LinearForm
        def force(v: Any, w: Any) -> Any:
            f = grad(w["x"])
            j = det(f)
            slope = (lam + mu) * (j - 1.0) - mu + w["push"]
            rub = ddot(stress(f, grad(w["past"])), mul(transpose(f), grad(v)))
            return mu * ddot(f, grad(v)) + slope * j * trace(mul(inv(f), grad(v))) + w["rate"] * rub

        @fem.BilinearForm
        def swell(u: Any, mean: Any, w: Any) -> Any:
            f = grad(w["x"])
            return mean * det(f) * trace(mul(inv(f), grad(u)))

        self._stiffness, self._force, self._swell = stiffness, force, swell

    def _rows(self, mesh: Any) -> np.ndarray:
        """Return scikit-fem's numbers (nodes, 3) of the components of the model's nodes."""
        solid = self.model.solid
        rows = np.empty((len(solid.points), 3), dtype=int)
        rows[: solid.corners] = self.basis.nodal_dofs.T
        own = {(int(a), int(b)): k for k, (a, b) in enumerate(np.sort(solid.edge_ends, axis=1))}
        for edge, (a, b) in enumerate(np.sort(mesh.edges.T, axis=1)):
            rows[solid.corners + own[(int(a), int(b))]] = self.basis.edge_dofs[:, edge]
        return rows

    def _vector(self, position: np.ndarray) -> np.ndarray:
        vector = np.empty(position.size)
        vector[self.rows] = position
        return vector

    def _ordered(self, values: np.ndarray) -> np.ndarray:
        return self._vector(values.reshape(-1, 3))

    def _gradient(
        self, pose: Pose, load: np.ndarray, dt: float, before: np.ndarray, flight: np.ndarray
    ) -> np.ndarray:
        """Return the gradient (nodes, 3) N of the step's objective in the nodes."""
        model, q = self.model, self.model.solid
        mass = model.nodal_mass[:, None]
        moved = pose.position - before
        push = np.zeros_like(pose.position)
        pressure = np.ascontiguousarray(load[: model.chambers])
        add_volume_gradient(
            pose.position, q.cavity_triangles, q.cavity_of_triangle, USED_TRIPLES, WEIGHTS, pressure, push
        )
        outer = push + mass * model.gravity_m_s2 + model.coupling.spread(0)[:, None] * load[model.chambers :]
        moving = mass * ((pose.position - flight) / dt**2 + model.rayleigh_mass_per_s / dt * moved)
        return self.force(pose.position) + moving - outer

    def _pressure_stiffness(self, pose: Pose, load: np.ndarray) -> sp.csr_matrix:
        """Return the derivative of the pressure's forces by the nodes, in scikit-fem's order."""
        model, q, pairs = self.model, self.model.solid, self.model.pairs
        blocks = np.zeros((len(pairs.first), 3, 3))
        pressure = -np.ascontiguousarray(load[: model.chambers])  # the model subtracts p.V
        add_volume_stiffness(
            pose.position, q.cavity_triangles, q.cavity_of_triangle, USED_TRIPLES, WEIGHTS, pressure,
            pairs.triangle_slots, blocks,
        )  # fmt: skip
        used = np.flatnonzero(blocks.any(axis=(1, 2)))
        first, second = self.rows[pairs.first[used]], self.rows[pairs.second[used]]
        row, column = np.broadcast_arrays(first[:, :, None], second[:, None, :])
        apart = (pairs.first[used] != pairs.second[used])[:, None, None] & np.ones((3, 3), bool)
        data = blocks[used]
        entries = (np.r_[data.ravel(), data[apart]], (np.r_[row.ravel(), column[apart]], np.r_[column.ravel(), row[apart]]))
        return sp.csr_matrix(entries, shape=(self.rows.size, self.rows.size))

    def _reduced(self, matrix: sp.csr_matrix, gradient: np.ndarray, pose: Pose) -> sp.csc_matrix:
        """Return ``matrix`` in the model's unknowns, with the turning of forces on rigid bodies."""
        coupling = self.model.coupling
        free = self.rows[coupling.free].ravel()
        parts = [(free, np.arange(len(free)), np.ones(len(free)))]
        turns = sp.lil_matrix((coupling.unknowns, coupling.unknowns))
        for k, member in enumerate(coupling.members):
            start, arm = coupling.body_slice(k).start, pose.position[member] - pose.centre[k]
            for i in range(3):
                spin = np.cross(np.eye(3)[i], arm)
                parts.append((self.rows[member, i], np.full(len(member), start + i), np.ones(len(member))))
                parts += [(self.rows[member, c], np.full(len(member), start + 3 + i), spin[:, c]) for c in range(3)]
            product = arm.T @ gradient[member]
            turn = 0.5 * (product + product.T) - np.trace(product) * np.eye(3)
            turns[start + 3 : start + 6, start + 3 : start + 6] = turn
        rows, columns, data = (np.concatenate(values) for values in zip(*parts, strict=True))
        nodes_of = sp.csr_matrix((data, (rows, columns)), shape=(matrix.shape[0], coupling.unknowns))
        return (nodes_of.T @ matrix @ nodes_of + turns).tocsc()
