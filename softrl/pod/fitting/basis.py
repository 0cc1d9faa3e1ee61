"""Proper orthogonal decomposition of the displacement, in the inner product of the nodal masses."""

from typing import NamedTuple

import numpy as np

from softrl.core.errors import ConfigError


class PodBasis(NamedTuple):
    """Modes (k, nodes, 3) kg^-0.5, orthonormal in the nodal masses; singular values (samples,) kg^0.5 m, falling."""

    modes: np.ndarray
    singular_values: np.ndarray


def pod_basis(displacement: np.ndarray, nodal_mass: np.ndarray, energy: float, modes_max: int) -> PodBasis:
    """Return the POD basis of ``displacement`` (samples, nodes, 3) m by the method of snapshots.

    Parameters
    ----------
    nodal_mass : (nodes,) kg
    energy : keep modes until this share of the squared singular values, in (0, 1]
    modes_max : at most this many

    Notes
    -----
    About the rest, not the mean, so that rest is represented exactly. Eigenvectors of the Gramian lose directions whose
    singular value is below 1e-7 of the largest; those are dropped, and the modes are orthonormalised once more.
    """
    if not 0.0 < energy <= 1.0:
        raise ConfigError(f"POD energy {energy:g} must be a share in (0, 1]")
    weighted = (displacement * np.sqrt(nodal_mass)[:, None]).reshape(len(displacement), -1).astype(float)
    squares, vectors = np.linalg.eigh(weighted @ weighted.T)
    squares, vectors = squares[::-1].clip(min=0.0), vectors[:, ::-1]
    share = np.cumsum(squares) / squares.sum()
    kept = min(modes_max, int(np.searchsorted(share, energy) + 1), int((squares > 1e-14 * squares[0]).sum()))
    rough = vectors[:, :kept].T @ weighted / np.sqrt(squares[:kept, None])
    exact, turn = np.linalg.qr(rough.T)
    modes = (exact * np.sign(np.diag(turn))).T.reshape(kept, -1, 3) / np.sqrt(nodal_mass)[:, None]
    return PodBasis(modes, np.sqrt(squares))


def projection_errors(basis: PodBasis, displacement: np.ndarray, nodal_mass: np.ndarray) -> np.ndarray:
    """Return the rms distance (modes + 1,) m of ``displacement`` from the span of the first 0, 1, .. modes.

    The mean is over samples and, by mass, over nodes.
    """
    root = np.sqrt(nodal_mass)[:, None]
    weighted = (displacement * root).reshape(len(displacement), -1).astype(float)
    amplitude = weighted @ (basis.modes * root).reshape(len(basis.modes), -1).T
    left = (weighted**2).sum(axis=1, keepdims=True) - np.cumsum(np.pad(amplitude**2, ((0, 0), (1, 0))), axis=1)
    return np.sqrt(left.clip(min=0.0).mean(axis=0) / nodal_mass.sum())
