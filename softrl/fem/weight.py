"""How a body at an equilibrium bears its own weight and inertia, which act on all of it and not at the tip alone.

A reduced body sees its weight through the centre of mass. To gravity the body also gives by shapes in which volumes and tip
stay: that softens a sagging body a little. To the inertia of its own motion it gives by others, which makes a swinging body
heavier the faster it swings: those of a motion that forces at the tip bring about, since its slow modes are nearly such. To
what damps that motion it gives by as many more: damping resists other parts than those that the loads strain. All are
first derivatives of the nodes: no sample needs another equilibrium.
"""

from typing import NamedTuple

import numpy as np

from softrl.fem.assembly import multiply_blocks
from softrl.fem.coupling import Pose
from softrl.fem.model import FemModel
from softrl.fem.tangent import Tangent

NUDGE_M = 1e-6  # for a difference of what is a square of positions
WEIGHT, MOTION = slice(0, 3), slice(3, 9)  # columns of forces that all of the body bears
PACE_S = 0.01  # speed by acceleration of a motion: makes the shapes of both of a size


class Weight(NamedTuple):
    """How an equilibrium answers gravity, ``w = n + 3`` loads.

    Attributes
    ----------
    tip_spin : (3, w) rotation of the plate by the loads, rad per Pa and N
    give : (3, 3) change of mass times centre of mass by gravity, volumes and tip held, kg s^2
    give_spin : (3, 3) rotation of the plate by gravity, volumes and tip held, rad s^2/m
    inner_give : (6, 6) twice the energy, m s^4/N, of the shapes by which the body gives to its inertia where the second
        derivative of a tip force is 1 N/s^2, and to what stiffness-proportional damping multiplies where its first derivative is
        ``PACE_S`` times that, volumes and tip held
    inner_spin : (3, 6) rotation of the plate by these shapes, rad s^2/N
    inner_mass : (6, 6) of these shapes, kg m^2 s^4/N^2
    inner_coupling : (6, w) of these shapes with the motion by the loads, in the mass, kg m^2 s^2/N per Pa and N
    inner_viscosity, inner_drag : (6, 6) and (6, w), likewise in what stiffness-proportional damping multiplies
    """

    tip_spin: np.ndarray
    give: np.ndarray
    give_spin: np.ndarray
    inner_give: np.ndarray
    inner_spin: np.ndarray
    inner_mass: np.ndarray
    inner_coupling: np.ndarray
    inner_viscosity: np.ndarray
    inner_drag: np.ndarray


def pull_of(model: FemModel, pose: Pose) -> np.ndarray:
    """Return the force (unknowns, 3) of unit gravity along each axis."""
    return np.stack([model.coupling.reduce(model.nodal_mass[:, None] * unit, pose) for unit in np.eye(3)], axis=1)


def swing_of(model: FemModel, pose: Pose, tangent: Tangent) -> np.ndarray:
    """Return the forces (unknowns, 6) of a motion that unit tip forces along each axis bring about: inertia, then damping."""
    moved = tangent.shapes[-3:]
    heavy = [model.nodal_mass[:, None] * shape for shape in moved]
    tough = [PACE_S * multiply_blocks(tangent.viscous, model.pairs.first, model.pairs.second, shape) for shape in moved]
    return np.stack([model.coupling.reduce(force, pose) for force in (*heavy, *tough)], axis=1)


def held_of(model: FemModel, pose: Pose, tangent: Tangent, free: np.ndarray) -> np.ndarray:
    """Return the shapes (unknowns, k) of ``free`` with volumes and tip held."""
    return free - tangent.change @ np.linalg.solve(tangent.compliance, model.load_directions(pose).T @ free)


def weight_of(model: FemModel, pose: Pose, tangent: Tangent, forces: np.ndarray, held: np.ndarray) -> Weight:
    """Return how an equilibrium bears weight and motion: to ``forces`` of both it gives by ``held`` (unknowns, 9) each.

    Those of ``pull_of`` come first, then those of ``swing_of``.
    """
    mass, plate = model.nodal_mass[:, None], model.coupling.body_slice(0)
    spin = slice(plate.start + 3, plate.stop)
    give, inner = (forces[:, side].T @ held[:, side] for side in (WEIGHT, MOTION))
    shapes, moved = np.stack([model.coupling.expand(x, pose) for x in held[:, MOTION].T]), tangent.shapes
    heavy = mass * shapes
    tough = np.stack([multiply_blocks(tangent.viscous, model.pairs.first, model.pairs.second, shape) for shape in shapes])
    return Weight(
        tangent.change[spin], 0.5 * (give + give.T), held[spin, WEIGHT], 0.5 * (inner + inner.T), held[spin, MOTION],
        np.einsum("ani,bni->ab", shapes, heavy), np.einsum("ani,bni->ab", heavy, moved),
        np.einsum("ani,bni->ab", shapes, tough), np.einsum("ani,bni->ab", tough, moved),
    )


def viscosity_by_gravity(
    model: FemModel, pose: Pose, tangent: Tangent, shapes: np.ndarray, bent: np.ndarray
) -> np.ndarray:
    """Return how the viscosity (3, w, w) by the loads changes as the body gives to unit gravity along each axis.

    ``shapes`` (3, nodes, 3) are what it gives by, ``bent`` (w, 3, nodes, 3) how they change with each load: by as much the
    shapes of motion change as the body gives, beside what resists them.
    """
    first, second, moved = model.pairs.first, model.pairs.second, tangent.shapes
    tough = np.stack([multiply_blocks(tangent.viscous, first, second, shape) for shape in moved])
    change = 2.0 * np.einsum("lkni,jni->klj", bent, tough, optimize=True)
    for k, shape in enumerate(shapes):
        part = NUDGE_M / np.abs(shape).max()
        there = Pose(pose.position + part * shape, pose.centre, pose.rotation)
        blocks = (model.viscous(there) - tangent.viscous) / part
        forces = np.stack([multiply_blocks(blocks, first, second, column) for column in moved])
        change[k] += np.einsum("ani,bni->ab", moved, forces)
    return 0.5 * (change + change.transpose(0, 2, 1))


def pull_at_rest(model: FemModel, gravity_m_s2: np.ndarray) -> np.ndarray:
    """Return the load (n + 3,) Pa and N that would load the stress-free body like its weight."""
    rest = model.rest()
    tangent = model.tangent(rest, np.zeros(model.chambers + 3))
    pull = model.coupling.reduce(model.nodal_mass[:, None] * gravity_m_s2, rest)
    return np.linalg.solve(tangent.compliance, tangent.change.T @ pull)
