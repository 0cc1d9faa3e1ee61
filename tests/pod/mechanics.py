"""The mechanical energy of a reduced body, which no step may add to."""

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.pod.kernel import VISCOUS
from softrl.pod.polynomial import basis, degree_of
from softrl.pod.potential import fill_behind, fill_elastic_factor
from softrl.pod.tables import tables_of


def mechanical_energy(
    model: ReducedModel,
    coordinate: np.ndarray,
    velocity: np.ndarray,
    gravity_m_s2: np.ndarray | None = None,
    lag: np.ndarray | None = None,
    inner: np.ndarray | None = None,
    dt_s: float = 0.0,
) -> np.ndarray:
    """Return kinetic, elastic and weight's energy (S,) J at z and its rate (S, n + 3), within the samples' ball.

    ``lag`` (S, n + 3) is the lagged rate, in which further elastic energy is stored; between steps of ``dt_s`` that
    store is the one ``VISCOUS`` of a step ahead. ``inner`` (S, 2, 3) is how far the inside gives, and its rate. None: nothing.
    """
    r = model.order
    inverse = np.linalg.inv(model.frame)
    y, rate = coordinate @ inverse.T, velocity @ inverse.T
    gravity = np.asarray(model.gravity_m_s2 if gravity_m_s2 is None else gravity_m_s2, dtype=float)
    maps = (model.energy, model.centre_of_mass, model.give, model.mass_root, model.give_root)
    widest = max(part.shape[-1] for part in maps)
    values = basis(r, degree_of(r, widest)).values(y)
    height = values[:, : model.centre_of_mass.shape[1]] @ model.centre_of_mass.T
    give = (values[:, : model.give.shape[1]] @ model.give.T).reshape(-1, 3, 3)
    settling = 0.5 * ((give @ gravity) ** 2).sum(axis=1)
    root = values[:, : model.mass_root.shape[1]] @ model.mass_root.T
    moving = np.einsum("sij,sj->si", root.reshape(-1, r, r), rate)
    energy = 0.5 * (moving**2).sum(axis=1) + values[:, : len(model.energy)] @ model.energy
    energy -= model.mass * height @ gravity + settling
    if inner is not None:
        rows = (values[:, : model.give_root.shape[1]] @ model.give_root.T).reshape(-1, r + 3, 3)
        pushed = np.einsum("sij,sj->si", rows, inner[:, 1])
        energy += 0.5 * (pushed**2).sum(axis=1) + (moving * pushed[:, :r]).sum(axis=1)
        energy += 0.5 * (np.einsum("sij,sj->si", give, inner[:, 0]) ** 2).sum(axis=1)
    if lag is None or not model.lag_root.size:
        return energy
    loose = _lag_roots(model, y + VISCOUS * dt_s * rate)
    pulled = np.einsum("sij,sj->si", loose, lag @ inverse.T)
    return energy + 0.5 * model.lag_ratio * model.rayleigh_stiffness_s**2 * (pulled**2).sum(axis=1)


def _lag_roots(model: ReducedModel, points: np.ndarray) -> np.ndarray:
    """Return R U' (S, r, r) of the viscosity that lags at ``points`` (S, r)."""
    tables, r = tables_of(model), model.order
    table = basis(r, degree_of(r, len(tables.parent)))
    factor, product = np.empty((r, r)), np.empty(r * r)
    found = []
    for row in table.values(points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1.0)):
        elastic = tables.elastic @ row[: tables.elastic.shape[1]]
        fill_elastic_factor(elastic, tables.elastic[:, 0], factor)
        fill_behind(model.lag_root @ row[: model.lag_root.shape[1]], factor, product)
        found.append(product.reshape(r, r).copy())
    return np.array(found)
