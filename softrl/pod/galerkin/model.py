"""POD Galerkin with ECSW: the full model's equations on the span of a few modes, elastic forces from few elements."""

import logging
from typing import Any, NamedTuple

import numba as nb
import numpy as np
from scipy.spatial.transform import Rotation

from softrl.artifacts.mesh import FREE
from softrl.core.errors import SolverError
from softrl.core.progress import progress
from softrl.fem.coupling import Pose
from softrl.fem.law import LAW, STRESS, TANGENT, VISCOUS, add_second_derivative_of_volume, cofactor_of
from softrl.fem.loads import add_volume_stiffness
from softrl.fem.material import Material
from softrl.fem.model import FemModel
from softrl.pod.fitting.basis import pod_basis
from softrl.pod.galerkin.hyperreduction import sample_elements

log = logging.getLogger(__name__)
_law = nb.types.FunctionType(LAW)
_f1, _f2, _f4 = (nb.types.Array(nb.float64, d, "C") for d in (1, 2, 4))


class GalerkinBody(NamedTuple):
    """What the reduced equations need; amplitudes q (r,) kg^0.5 m, nodes = rest + modes q.

    Attributes
    ----------
    law_parameters, bulk_pa : of the law's kernel; the second weighs the mean change of volume of an element
    slope : (elements, gauss, 9, r) change of the deformation gradient at the sampled elements' points per amplitude
    weight : (elements, gauss) m^3, Gauss weights times those of ECSW
    volume_slope : (n, r);  volume_bend : (n, r, r);  volume_twist : (n, r, r, r), V = V0 + a.q + q.B q / 2 + C q q q / 6
    tip : (3, r) m, tip per amplitude
    centre_of_mass : (3, r), displacement of the centre of mass per amplitude
    plate : (r + 1, 3, 3) moments of the plate's nodes, at rest and per amplitude, whose polar part is its rotation
    reach : largest nodal shift per amplitude, m
    rest_tip : (3,) m;  rest_volume : (n,) m^3;  mass : kg
    elements : number of sampled elements;  sampling_error : what ECSW leaves, relative
    """

    law_parameters: np.ndarray
    bulk_pa: float
    slope: np.ndarray
    weight: np.ndarray
    volume_slope: np.ndarray
    volume_bend: np.ndarray
    volume_twist: np.ndarray
    tip: np.ndarray
    centre_of_mass: np.ndarray
    plate: np.ndarray
    reach: float
    rest_tip: np.ndarray
    rest_volume: np.ndarray
    mass: float
    elements: int
    sampling_error: float


def full_displacements(
    model: FemModel, loads: np.ndarray, corner_displacement: np.ndarray
) -> np.ndarray:
    """Return the displacements (samples, nodes, 3) m of all nodes from those of the corners (samples, corners, 3) m.

    Middles of edges start half-way between their ends and are let go by Newton's method under ``loads``.
    """
    found = []
    for load, corners in progress(list(zip(loads, corner_displacement, strict=True)), "nodes between corners"):
        solve = model.static(load, _pose_of(model, corners.astype(float)))
        if not solve.failure:
            found.append(solve.pose.position - model.solid.points)
    if not found:
        raise SolverError("no snapshot is an equilibrium of this mesh and material; rerun stage=fem with them")
    return np.array(found)


def moving_displacements(model: FemModel, load: np.ndarray, dt_s: float) -> np.ndarray:
    """Return the displacements (steps, nodes, 3) m of the motion from rest under ``load`` (steps, n + 3)."""
    state, found = model.state(), []
    for row in progress(load, "motion of the full model"):
        state, solve = model.step(state, row, dt_s)
        if solve.failure:
            raise SolverError(f"a training step of {dt_s:g} s failed, {solve.failure}")
        found.append(state.pose.position - model.solid.points)
    return np.array(found)


def build_body(
    model: FemModel, material: Material, displacement: np.ndarray, modes: int, tolerance: float, most: int,
    training: int,
) -> GalerkinBody:
    """Return the Galerkin body on the POD basis of ``displacement`` (samples, nodes, 3) m.

    Parameters
    ----------
    modes : at most so many;  tolerance, most : of ECSW, see ``sample_elements``
    training : samples, spread evenly, on which ECSW is trained
    """
    basis = pod_basis(displacement, model.nodal_mass, 1.0, modes).modes  # (r, nodes, 3)
    root = model.nodal_mass[:, None]
    amplitude = np.einsum("sni,rni->sr", displacement * root, basis)
    chosen = np.unique(np.linspace(0, len(displacement) - 1, min(training, len(displacement))).astype(int))
    slope = _slopes(model, basis)  # (elements, gauss, 9, r)
    work = np.concatenate([element_work(model, material, slope, q) for q in amplitude[chosen]])
    sampling = sample_elements(work, tolerance, most)
    log.info("ECSW keeps %d of %d elements", len(sampling.elements), work.shape[1])
    weight = model._weights[sampling.elements] * sampling.weights[:, None]
    volume = [_volume_tensors(model, basis, k) for k in range(model.chambers)]
    plate = model.coupling.members[0]
    moment = _plate_moments(model, basis, plate)
    spread = model.coupling.spread(0)
    return GalerkinBody(
        law_parameters=model._parameters, bulk_pa=_bulk(model),
        slope=np.ascontiguousarray(slope[sampling.elements]), weight=np.ascontiguousarray(weight),
        volume_slope=np.array([v[0] for v in volume]), volume_bend=np.array([v[1] for v in volume]),
        volume_twist=np.array([v[2] for v in volume]), tip=np.einsum("n,rni->ir", spread, basis),
        centre_of_mass=np.einsum("n,rni->ir", model.nodal_mass, basis) / model.nodal_mass.sum(), plate=moment,
        reach=float(np.abs(basis).max()), rest_tip=model.rest_tip, rest_volume=model.rest_volume,
        mass=float(model.nodal_mass.sum()), elements=len(sampling.elements), sampling_error=sampling.error,
    )  # fmt: skip


def element_work(model: FemModel, material: Material, slope: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """Return the elastic force (r, elements) of every element on every mode at ``amplitude`` (r,)."""
    strain = np.eye(3).ravel() + slope @ amplitude
    stress = stresses(type(material).kernel, model._parameters, _bulk(model), strain, model._weights)
    return np.einsum("eqi,eqir->re", stress * model._weights[..., None], slope, optimize=True)


def _bulk(model: FemModel) -> float:
    """Return the modulus that weighs an element's mean change of volume; zero where the model takes each point's."""
    return float(model._bulk_pa)


def _slopes(model: FemModel, basis: np.ndarray) -> np.ndarray:
    """Return the change (elements, gauss, 9, r) of the deformation gradient per amplitude."""
    local = basis[:, model._elements]  # (r, elements, nodes, 3)
    slope = np.einsum("reai,eqaj->eqijr", local, model._gradients, optimize=True)
    return np.ascontiguousarray(slope.reshape(*slope.shape[:2], 9, -1))


def _volume_tensors(model: FemModel, basis: np.ndarray, chamber: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return slope (r,), bend (r, r) and twist (r, r, r) of a chamber's volume, which is a cubic of the nodes."""
    unit = -np.eye(model.chambers)[chamber]

    def bends(position: np.ndarray) -> np.ndarray:
        """Return the Hessian (r, r) of the volume in the amplitudes at nodes ``position``; linear in it."""
        blocks = np.zeros((len(model.pairs.first), 3, 3))
        add_volume_stiffness(position, *model._surface, unit, model.pairs.triangle_slots, blocks)
        used = np.flatnonzero(blocks.any(axis=(1, 2)))
        first, second = basis[:, model.pairs.first[used]], basis[:, model.pairs.second[used]]
        half = np.einsum("rpi,pij,spj->rs", first, blocks[used], second, optimize=True)
        own = (model.pairs.first[used] == model.pairs.second[used])[:, None, None]
        twice = np.einsum("rpi,pij,spj->rs", first, blocks[used] * own, second, optimize=True)
        return half + half.T - twice

    rest = bends(model.solid.points)
    twist = np.array([bends(np.ascontiguousarray(mode)) for mode in basis])
    slope = np.array(
        [_volume_slope(model, np.ascontiguousarray(mode), chamber) for mode in basis]
    )
    return slope, rest, twist


def _volume_slope(model: FemModel, mode: np.ndarray, chamber: int) -> float:
    """Return dV / dq for one mode (nodes, 3) at rest: exact, for V is a cubic along it."""
    size = 1e-2 / np.abs(mode).max()
    rest = model.rest()
    at = [
        model.volumes(Pose(rest.position + s * size * mode, rest.centre, rest.rotation))[chamber] for s in (-2, -1, 1, 2)
    ]
    return float((at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * size))


def _plate_moments(model: FemModel, basis: np.ndarray, plate: np.ndarray) -> np.ndarray:
    arm = model.solid.points[plate] - model.solid.points[plate].mean(axis=0)
    parts = [np.einsum("ni,nj->ij", arm, arm)]
    parts += [np.einsum("ni,nj->ij", mode[plate] - mode[plate].mean(axis=0), arm) for mode in basis]
    return np.array(parts)


def _pose_of(model: FemModel, corners: np.ndarray) -> Pose:
    """Return a pose with these corner displacements, rigid bodies rigid, other nodes half-way between the ends."""
    solid, coupling = model.solid, model.coupling
    position = solid.points.copy()
    position[: solid.corners] += corners
    if len(position) > solid.corners:
        position[solid.corners :] += corners[solid.edge_ends].mean(axis=1)
    centre, rotation = coupling.centres.copy(), np.tile(np.eye(3), (len(coupling.members), 1, 1))
    for k, (member, arm) in enumerate(zip(coupling.members, coupling.arms, strict=True)):
        moved = position[member]
        turn, _ = Rotation.align_vectors(moved - moved.mean(axis=0), arm - arm.mean(axis=0))
        rotation[k] = turn.as_matrix()
        centre[k] = moved.mean(axis=0) - rotation[k] @ arm.mean(axis=0)
        position[member] = centre[k] + arm @ rotation[k].T
    held = np.flatnonzero((coupling.body < 0) & (solid.region != FREE))
    position[held] = solid.points[held]
    return Pose(position, centre, rotation)


@nb.njit(cache=True)
def stresses(law: Any, parameters: np.ndarray, bulk: float, gradient: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the first Piola-Kirchhoff stresses (elements, gauss, 9) Pa at deformation gradients of that shape.

    ``bulk`` Pa weighs the mean change of volume of an element, as in the full model; ``weight`` (elements, gauss) m^3.
    """
    elements, gauss, _ = gradient.shape
    found, tangent = np.zeros_like(gradient), np.zeros((9, 9))
    f, p, c = np.empty((3, 3)), np.zeros((3, 3)), np.zeros((gauss, 3, 3))
    for e in range(elements):
        swept = volume = 0.0
        for k in range(gauss):
            f[:] = gradient[e, k].reshape(3, 3)
            swept += weight[e, k] * cofactor_of(f, c[k])
            volume += weight[e, k]
        push = bulk * (swept / volume - 1.0)
        for k in range(gauss):
            f[:] = gradient[e, k].reshape(3, 3)
            law(parameters, f, p, tangent, STRESS)
            for i in range(9):
                found[e, k, i] = p[i // 3, i % 3] + push * c[k, i // 3, i % 3]
    return found


@nb.njit(
    nb.float64(_law, _f1, nb.float64, _f4, _f2, _f1, nb.int64, _f1, _f2),
    cache=True, fastmath={"contract", "reassoc", "nsz"},
)  # fmt: skip
def elastic(
    law: Any, parameters: np.ndarray, bulk: float, slope: np.ndarray, weight: np.ndarray, q: np.ndarray, order: int,
    gradient: np.ndarray, hessian: np.ndarray,
) -> float:
    """Return the elastic energy in J at amplitudes ``q`` and fill its gradient (r,) and Hessian (r, r) as asked.

    With the order ``VISCOUS`` and the law ``fem.damping.viscous`` the Hessian is what damping multiplies.
    """
    elements, gauss, _, r = slope.shape
    f, p, tangent = np.empty((gauss, 3, 3)), np.zeros((3, 3)), np.zeros((9, 9))
    c, half, normal = np.zeros((gauss, 3, 3)), np.empty((9, r)), np.empty(r)
    energy = push = volume = 0.0
    if order >= STRESS:
        gradient[:] = 0.0
    if order >= TANGENT:
        hessian[:] = 0.0
    for e in range(elements):
        swept = volume = 0.0
        for k in range(gauss):
            for i in range(9):
                total = 1.0 if i % 4 == 0 else 0.0
                for a in range(r):
                    total += slope[e, k, i, a] * q[a]
                f[k, i // 3, i % 3] = total
            if bulk > 0.0:
                swept += weight[e, k] * cofactor_of(f[k], c[k])
                volume += weight[e, k]
        if bulk > 0.0:
            push = bulk * (swept / volume - 1.0) if order < VISCOUS else 0.0  # viscosity has no stress of its own
            energy += 0.5 * push * (swept - volume)
            normal[:] = 0.0
        for k in range(gauss):
            density = law(parameters, f[k], p, tangent, order)
            if density == np.inf:
                return np.inf
            energy += weight[e, k] * density
            if order < STRESS:
                continue
            for i in range(9):
                own = weight[e, k] * (p[i // 3, i % 3] + push * c[k, i // 3, i % 3])
                swell = weight[e, k] * c[k, i // 3, i % 3]
                for a in range(r):
                    gradient[a] += own * slope[e, k, i, a]
                    normal[a] += swell * slope[e, k, i, a]
            if order < TANGENT:
                continue
            if bulk > 0.0:
                add_second_derivative_of_volume(push, f[k], tangent)
            for i in range(9):
                for a in range(r):
                    half[i, a] = 0.0
                for j in range(9):
                    t = weight[e, k] * tangent[i, j]
                    if t != 0.0:
                        for a in range(r):
                            half[i, a] += t * slope[e, k, j, a]
            for i in range(9):
                for a in range(r):
                    s = slope[e, k, i, a]
                    for b in range(a + 1):
                        hessian[a, b] += s * half[i, b]
        if order >= TANGENT and bulk > 0.0:
            for a in range(r):
                for b in range(a + 1):
                    hessian[a, b] += bulk / volume * normal[a] * normal[b]
    if order >= TANGENT:
        for a in range(r):
            for b in range(a):
                hessian[b, a] = hessian[a, b]
    return energy
