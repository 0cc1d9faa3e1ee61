"""The mechanical energy of a reduced body, which no step may add to."""

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.pod.polynomial import basis, degree_of


def mechanical_energy(
    model: ReducedModel,
    coordinate: np.ndarray,
    velocity: np.ndarray,
    gravity_m_s2: np.ndarray | None = None,
    inner: np.ndarray | None = None,
    dt_s: float = 0.0,
) -> np.ndarray:
    """Return kinetic, elastic and weight's energy (S,) J at z and its rate (S, n + 3), within the samples' ball.

    ``inner`` (S, 2, 3) is how far the inside gives, and its rate. None: nothing. Rates of steps of ``dt_s`` belong to half
    way of the step that led to z; the inside is as stiff as half way of the next.
    """
    r = model.order
    inverse = np.linalg.inv(model.frame)
    y, rate = coordinate @ inverse.T, velocity @ inverse.T
    gravity = np.asarray(model.gravity_m_s2 if gravity_m_s2 is None else gravity_m_s2, dtype=float)
    values = _values(model, y)
    height = values[:, : model.centre_of_mass.shape[1]] @ model.centre_of_mass.T
    settling = 0.5 * ((_roots(model.give, values) @ gravity) ** 2).sum(axis=1)
    energy = values[:, : len(model.energy)] @ model.energy - model.mass * height @ gravity - settling
    behind, ahead = _values(model, y - 0.5 * dt_s * rate), _values(model, y + 0.5 * dt_s * rate)
    entries = behind[:, : model.mass_root.shape[1]] @ model.mass_root.T
    upper = np.zeros((len(y), r, r))
    upper[:, *np.triu_indices(r)] = entries
    root = (upper + np.triu(upper, 1).transpose(0, 2, 1)) @ model.mass_factor.T
    moving = np.einsum("sij,sj->si", root, rate)
    energy += 0.5 * (moving**2).sum(axis=1)
    if inner is not None:
        pushed = np.einsum("sij,sj->si", _roots(model.give_root, behind), inner[:, 1])
        energy += 0.5 * (pushed**2).sum(axis=1) + (moving * pushed[:, :r]).sum(axis=1)
        energy += 0.5 * (np.einsum("sij,sj->si", _roots(model.give, ahead), inner[:, 0]) ** 2).sum(axis=1)
    return np.asarray(energy)


def _values(model: ReducedModel, y: np.ndarray) -> np.ndarray:
    maps = (model.energy, model.centre_of_mass, model.give, model.mass_root, model.give_root)
    points = y / np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1.0)
    return basis(model.order, degree_of(model.order, max(part.shape[-1] for part in maps))).values(points)


def _roots(coefficients: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return rows (S, m, 3) of three columns."""
    return (values[:, : coefficients.shape[1]] @ coefficients.T).reshape(len(values), -1, 3)
