"""What compiled code reads of a reduced model: its polynomials with their derivatives, under a gravity and scales."""

from collections.abc import Sequence

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.core.polynomial import basis, count, degree_of, sum_of_squares
from softrl.pod.step.layers import layered, sum_of
from softrl.pod.step.potential import Tables

WALL = 3.0  # of the largest curvature at rest: what rises outside the samples
MAPS = ("amplitudes", "inner_give", "inner_rotation", "inner_root", "drag_root")


def tables_of(
    model: ReducedModel,
    gravity_m_s2: np.ndarray | None = None,
    youngs_modulus_scale: float = 1.0,
    damping_scale: float = 1.0,
    mass_scale: float = 1.0,
    layer_scales: Sequence[float] | None = None,
) -> Tables:
    """Return the kernels' tables of ``model``.

    Parameters
    ----------
    gravity_m_s2 : (3,) in the base frame; the model's own if None
    youngs_modulus_scale : of the elastic energy and of the stiffness that damps
    damping_scale : of both Rayleigh coefficients
    mass_scale : of inertia and weight
    layer_scales : (layers,) of the elastic energy of each layer, from below; ones if None
    """
    gravity = np.array(model.gravity_m_s2 if gravity_m_s2 is None else gravity_m_s2, dtype=float)
    r, n = model.order, model.chambers
    mass = mass_scale * model.mass
    energy, centre_of_mass, turned = layered(model, layer_scales)
    weight = gradient_of(centre_of_mass, r)  # (r, 3, k)
    more = mass_scale / youngs_modulus_scale  # heavier, and softer, a body gives more
    give, give_rotation = (mass_scale * more) ** 0.5 * model.give, more * model.give_rotation
    pressed = np.einsum("j,ijk->ik", gravity, give.reshape(3, 3, -1))
    drop, settling = mass * gravity @ centre_of_mass, 0.5 * sum_of_squares(r, pressed)
    by_axis = give_rotation.reshape(3, 3, -1).transpose(1, 0, 2)
    turn = sum_of(turned, np.einsum("j,jik->ik", gravity, by_axis))
    potential = sum_of(np.zeros(count(r, 2)), sum_of(youngs_modulus_scale * energy, -sum_of(drop, settling)))
    degree = degree_of(r, len(potential))
    gradient, hessian = basis(r, degree).derivative(potential), basis(r, degree).hessian(potential)
    by_gravity = model.stiffness_root_by_gravity
    weighed = np.einsum("j,jik->ik", more * gravity, by_gravity.reshape(3, -1, by_gravity.shape[1]))
    stiffness_root = sum_of(model.stiffness_root, weighed)
    maps = (gradient, weight, model.rotation, turn, by_axis, stiffness_root, *(getattr(model, name) for name in MAPS))
    full = basis(r, max(degree_of(r, table.shape[-1]) for table in maps if table.shape[-1]))
    inverse = np.linalg.inv(model.frame)
    quadratic = youngs_modulus_scale * hessian_at_rest(energy, r)
    compliance = np.linalg.inv(inverse.T @ quadratic @ inverse)
    return Tables(
        *map(
            np.ascontiguousarray,
            (
                model.frame,
                inverse,
                full.parent,
                full.variable,
                full.degrees.astype(float),
                1.0 / (full.degrees + 1.0),
                gradient,
                hessian,
                quadratic,
                model.amplitudes,
                gradient_of(model.amplitudes, r).transpose(1, 0, 2).reshape(len(model.amplitudes) * r, -1),
                stiffness_root,
                model.stiffness_factor,
                mass * weight.transpose(1, 0, 2),
                model.rotation,
                turn,
                by_axis,
                youngs_modulus_scale**0.5 * model.inner_give,
                model.inner_root,
                model.drag_root,
                model.inner_rotation,
                model.rest_volume,
                model.rest_tip,
                np.diag(np.linalg.inv(compliance[:n, :n])) * model.rest_volume,
                gravity,
                np.array(
                    [
                        mass_scale,
                        damping_scale * mass_scale * model.rayleigh_mass_per_s,
                        damping_scale * youngs_modulus_scale * model.rayleigh_stiffness_s,
                        WALL * np.linalg.eigvalsh(quadratic)[-1],
                    ]
                ),
            ),
        )
    )


def gradient_of(coefficients: np.ndarray, order: int) -> np.ndarray:
    """Return the gradient (order, ..., monomials) of polynomials ``coefficients`` (..., monomials)."""
    return basis(order, degree_of(order, coefficients.shape[-1])).derivative(coefficients)


def hessian_at_rest(energy: np.ndarray, r: int) -> np.ndarray:
    """Return the Hessian (r, r) by y at rest, J, of an ``energy`` (monomials,)."""
    full = np.zeros((r, r))
    quadratic = energy[1 + r : 1 + r + r * (r + 1) // 2]
    full[np.triu_indices(r)] = np.pad(quadratic, (0, r * (r + 1) // 2 - len(quadratic)))
    return full + full.T


def mass_at_rest(model: ReducedModel) -> np.ndarray:
    """Return the mass (r, r) kg m^2 in y at rest."""
    lead = model.amplitudes[:, 1 : 1 + model.order]
    return np.asarray(lead.T @ lead)
