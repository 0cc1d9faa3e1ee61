"""Linear tetrahedra in a frame along their first edges, stepped by one linear solve: SOFA's corotational body.

The frame is cheap and is not the rotation of the polar decomposition (``material.Corotational``): it turns with shear
too, so the force has no energy, and with strain the answers part in second order. It serves comparisons with SOFA.
"""

from typing import NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.mesh import Mesh
from softrl.core.errors import SolverError
from softrl.fem.assembly import multiply_blocks, node_pairs
from softrl.fem.coupling import Coupling, Pose
from softrl.fem.elements import linear_mesh, rigid_bodies
from softrl.fem.loads import VOLUME_RULE, add_volume_gradient
from softrl.fem.material import lame
from softrl.fem.solver import linear_solver


class Motion(NamedTuple):
    """A moving body: where it is, and the rate (unknowns,) of its unknowns, m/s and rad/s."""

    pose: Pose
    rate: np.ndarray


class EdgeFrameBody:
    """Hooke's law in the frame of each tetrahedron's nodes 0, 1, 2, with rigid plate and ribs and a fixed base.

    Parameters
    ----------
    mesh : its cavity triangles may lie on any nodes
    youngs_modulus_pa, poisson : of the linear law
    nodal_mass : (nodes,) kg
    rayleigh_stiffness_s : damping force b K v
    """

    def __init__(
        self, mesh: Mesh, youngs_modulus_pa: float, poisson: float, nodal_mass: np.ndarray, rayleigh_stiffness_s: float
    ) -> None:
        self.solid = solid = linear_mesh(mesh)
        self.nodal_mass, self.rayleigh_stiffness_s = np.asarray(nodal_mass, dtype=float), rayleigh_stiffness_s
        self.pairs = node_pairs(len(solid.points), solid.elements, solid.cavity_triangles)
        bodies = rigid_bodies(solid.region)
        centres = np.array([solid.points[solid.region == number].mean(axis=0) for number in bodies])
        self.coupling = Coupling(solid.points, solid.region, bodies, centres, self.pairs)
        self._surface = (solid.cavity_triangles, solid.cavity_of_triangle, *VOLUME_RULE[3])
        self._lame = lame(youngs_modulus_pa, poisson)
        self._shapes, self._volume = np.ascontiguousarray(solid.gradients[:, 0]), solid.weights[:, 0]
        self._rest_axes = _axes(solid.points[solid.elements])
        self._rest_stiffness = self._linear_stiffness()
        self._solver = linear_solver()

    def rest(self) -> Motion:
        """Return the stress-free body at rest."""
        return Motion(self.coupling.rest(), np.zeros(self.coupling.unknowns))

    def step(self, motion: Motion, pressure: np.ndarray, dt: float) -> Motion:
        """Return the motion ``dt`` seconds later under ``pressure`` (chambers,) Pa, by one linear solve.

        (M + h (h + b) K) dv = h (f - (h + b) K v) with force f and stiffness K where the step begins; pressure has
        no stiffness in K.
        """
        pose, lag = motion.pose, dt + self.rayleigh_stiffness_s
        force, blocks = self._force_and_stiffness(pose, pressure)
        forward = self.coupling.expand(motion.rate, pose)
        push = self.coupling.reduce(force - lag * multiply_blocks(blocks, self.pairs.first, self.pairs.second, forward), pose)
        matrix = dt * lag * blocks
        matrix[self.pairs.diagonal[:, None], range(3), range(3)] += self.nodal_mass[:, None]
        rate = motion.rate + self._solve(matrix, dt * push, pose)
        return Motion(self.coupling.move(pose, dt * rate), rate)

    def static(self, pressure: np.ndarray, start: Pose, tolerance_m: float, max_iterations: int) -> Pose:
        """Return the equilibrium near ``start``; the steps shrink linearly, because K is not the whole tangent."""
        pose = start
        for _ in range(max_iterations):
            force, blocks = self._force_and_stiffness(pose, pressure)
            change = self._solve(blocks, self.coupling.reduce(force, pose), pose)
            pose = self.coupling.move(pose, change)
            if np.abs(change[: 3 * len(self.coupling.free)]).max() < tolerance_m:
                return pose
        raise SolverError(
            f"no equilibrium in {max_iterations} iterations at {np.array2string(pressure, precision=0)} Pa; "
            "use smaller steps of pressure"
        )

    def _force_and_stiffness(self, pose: Pose, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodal forces (nodes, 3) N and the stiffness without change of frames (pairs, 3, 3) N/m."""
        corner = pose.position[self.solid.elements]
        turn = np.einsum("eki,ekj->eij", _axes(corner), self._rest_axes)
        gradient = np.einsum("eai,eaj->eij", corner, self._shapes)
        local = np.einsum("eki,ekj->eij", turn, gradient)
        strain = 0.5 * (local + np.swapaxes(local, 1, 2)) - np.eye(3)
        lam, mu = self._lame
        stress = 2.0 * mu * strain + lam * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        pull = np.einsum("e,eij,ejk,eak->eai", self._volume, turn, stress, self._shapes, optimize=True)
        force = np.zeros_like(pose.position)
        np.add.at(force, self.solid.elements, -pull)
        add_volume_gradient(pose.position, *self._surface, np.ascontiguousarray(pressure, dtype=float), force)
        blocks = np.zeros((len(self.pairs.first), 3, 3))
        _add_turned(self._rest_stiffness, turn, self.pairs.element_slots, blocks)
        return force, blocks

    def _linear_stiffness(self) -> np.ndarray:
        """Return the stiffness (elements, 4, 4, 3, 3) N/m of each element at rest."""
        lam, mu = self._lame
        g = self._shapes
        product = np.einsum("eai,ebj->eabij", g, g)
        along = np.einsum("eai,ebi->eab", g, g)[..., None, None] * np.eye(3)
        return self._volume[:, None, None, None, None] * (lam * product + mu * (np.swapaxes(product, 3, 4) + along))

    def _solve(self, blocks: np.ndarray, push: np.ndarray, pose: Pose) -> np.ndarray:
        if not self._solver.factorise(self.coupling.stiffness(blocks, np.zeros_like(pose.position), pose)):
            raise SolverError("the stiffness is not positive: a mechanism, or an element of no volume")
        return self._solver.solve(push)


def _axes(corner: np.ndarray) -> np.ndarray:
    """Return the axes (elements, 3, 3), one a row: along edge 01, across it in the face 012, and its normal."""
    first = corner[:, 1] - corner[:, 0]
    normal = np.cross(first, corner[:, 2] - corner[:, 0])
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first), normal], axis=1)


@nb.njit(cache=True)
def _add_turned(stiffness: np.ndarray, turn: np.ndarray, slots: np.ndarray, blocks: np.ndarray) -> None:
    """Add each element's ``stiffness`` (elements, 4, 4, 3, 3), turned by ``turn``, to the node-pair ``blocks``."""
    half = np.empty((3, 3))
    for e in range(len(turn)):
        for a in range(4):
            for b in range(4):
                slot = slots[e, a, b]
                if slot < 0:
                    continue
                for i in range(3):
                    for j in range(3):
                        half[i, j] = 0.0
                        for k in range(3):
                            half[i, j] += turn[e, i, k] * stiffness[e, a, b, k, j]
                for i in range(3):
                    for j in range(3):
                        for k in range(3):
                            blocks[slot, i, j] += half[i, k] * turn[e, j, k]
