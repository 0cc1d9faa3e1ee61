"""The mechanical energy of a reduced body, which no step may add to."""

import numpy as np

from softrl.artifacts.reduced_model import SHAPES, TRIANGLE, ReducedModel
from softrl.core.polynomial import basis, degree_of


def mechanical_energy(
    model: ReducedModel,
    coordinate: np.ndarray,
    velocity: np.ndarray,
    gravity_m_s2: np.ndarray | None = None,
    inner: np.ndarray | None = None,
    dt_s: float = 0.0,
) -> np.ndarray:
    """Return kinetic, elastic and weight's energy (S,) J at z and its rate (S, n + 3), within the samples' ball.

    ``inner`` (S, 2, 6) is how far the inside gives, and its rate. None: nothing. Rates of steps of ``dt_s`` are those of the
    amplitudes in the step that led to z; the inside is as stiff as half way of the next.
    """
    r = model.order
    inverse = np.linalg.inv(model.frame)
    y, rate = coordinate @ inverse.T, velocity @ inverse.T
    gravity = np.asarray(model.gravity_m_s2 if gravity_m_s2 is None else gravity_m_s2, dtype=float)
    values = _values(model, y)
    height = values[:, : model.centre_of_mass.shape[1]] @ model.centre_of_mass.T
    settling = 0.5 * ((_roots(model.give, values) @ gravity) ** 2).sum(axis=1)
    energy = values[:, : len(model.energy)] @ model.energy - model.mass * height @ gravity - settling
    lead = _lead(model, y)
    step = dt_s or 1e-6
    moving = (_amplitudes(model, y) - _amplitudes(model, y - step * rate)) / step
    energy += 0.5 * (moving**2).sum(axis=1)
    if inner is not None:
        root = np.linalg.cholesky(lead.transpose(0, 2, 1) @ lead).transpose(0, 2, 1)
        pushed = np.einsum("sij,sj->si", _inside(model.inner_root, values), inner[:, 1])
        energy += 0.5 * (pushed**2).sum(axis=1) + (np.einsum("sij,sj->si", root, rate) * pushed[:, :r]).sum(axis=1)
        ahead = _values(model, y + 0.5 * dt_s * rate)
        energy += 0.5 * (np.einsum("sij,sj->si", _inside(model.inner_give, ahead), inner[:, 0]) ** 2).sum(axis=1)
    return np.asarray(energy)


def _values(model: ReducedModel, y: np.ndarray) -> np.ndarray:
    maps = (model.energy, model.centre_of_mass, model.give, model.inner_give, model.amplitudes, model.inner_root)
    return basis(model.order, degree_of(model.order, max(part.shape[-1] for part in maps))).values(_in_ball(y))


def _in_ball(y: np.ndarray) -> np.ndarray:
    return np.asarray(y / np.maximum(np.linalg.norm(y, axis=1, keepdims=True), 1.0))


def _lead(model: ReducedModel, y: np.ndarray) -> np.ndarray:
    """Return the gradient (S, k, r) of the amplitudes, outside the ball that at its surface."""
    table = basis(model.order, degree_of(model.order, model.amplitudes.shape[1]))
    return np.asarray(np.einsum("srm,km->skr", table.gradient_rows(_in_ball(y)), model.amplitudes))


def _amplitudes(model: ReducedModel, y: np.ndarray) -> np.ndarray:
    """Return the amplitudes (S, k), which go on straight outside the ball."""
    inside = _values(model, y)[:, : model.amplitudes.shape[1]] @ model.amplitudes.T
    return np.asarray(inside + np.einsum("skr,sr->sk", _lead(model, y), y - _in_ball(y)))


def _roots(coefficients: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return rows (S, m, 3) of three columns."""
    return (values[:, : coefficients.shape[1]] @ coefficients.T).reshape(len(values), -1, 3)


def _inside(coefficients: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return rows (S, k + 6, 6), the last six an upper triangle."""
    rows = values[:, : coefficients.shape[1]] @ coefficients.T
    triangle = np.zeros((len(rows), SHAPES, SHAPES))
    triangle[:, *np.triu_indices(SHAPES)] = rows[:, -TRIANGLE:]
    return np.concatenate([rows[:, :-TRIANGLE].reshape(len(rows), -1, SHAPES), triangle], axis=1)
