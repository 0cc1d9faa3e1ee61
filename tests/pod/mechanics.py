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
) -> np.ndarray:
    """Return kinetic, elastic and weight's energy (S,) J at z and its rate (S, n + 3), within the samples' ball.

    ``inner`` (S, 2, 3) is how far the inside gives, and its rate. None: nothing.
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
    return energy
