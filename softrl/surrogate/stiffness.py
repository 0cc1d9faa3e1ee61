"""Springs of the chain's joints from the body's own tip compliance."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

from softrl.core.errors import SolverError
from softrl.surrogate.kinematics import Chain, joint_jacobians

Statics = Callable[[np.ndarray], np.ndarray]  # loads (S, n + 3) Pa and N -> tips (S, 3) m at equilibrium


def body_compliance(tip_of: Statics, pressure: np.ndarray, force: float) -> np.ndarray:
    """Return d tip / d force (S, 3, 3) m/N of the body at ``pressure`` (S, n) Pa, by central differences of ``force`` N."""
    columns = []
    for axis in range(3):
        push = np.zeros((len(pressure), 3))
        push[:, axis] = force
        columns.append((tip_of(np.hstack([pressure, push])) - tip_of(np.hstack([pressure, -push]))) / (2.0 * force))
    return np.stack(columns, axis=2)


def chain_compliance(theta: np.ndarray, chain: Chain, stiffness: np.ndarray) -> np.ndarray:
    """Return d tip / d force (S, 3, 3) m/N of the chain at grouped commands (S, 3): sum of J J' / k over its joints."""
    jacobian = joint_jacobians(theta, chain)
    return np.einsum("sij,skj,j->sik", jacobian, jacobian, np.tile(1.0 / stiffness, len(chain.below)))


def fit_joint_stiffness(theta: np.ndarray, chain: Chain, compliance: np.ndarray) -> np.ndarray:
    """Return k (3,) N m/rad, N m/rad, N/m of hinges and slides that explain ``compliance`` (S, 3, 3) m/N at ``theta`` (S, 3).

    Notes
    -----
    The chain's compliance is linear in the joints' compliances: non-negative least squares on its diagonal, each axis
    relative to its mean over the samples.
    """
    jacobian = joint_jacobians(theta, chain)
    samples = len(theta)
    by_kind = (jacobian**2).reshape(samples, 3, -1, 3).sum(axis=2)  # (S, axis, kind of joint)
    measured = np.einsum("sii->si", compliance)
    weight = 1.0 / measured.mean(axis=0)
    design, wanted = (by_kind * weight[:, None]).reshape(-1, 3), (measured * weight).ravel()
    scale = design.max(axis=0)
    soft = nnls(design / scale, wanted)[0] / scale
    if (soft <= 0.0).any():
        raise SolverError(
            f"joint compliances {soft} rad/(N m), rad/(N m), m/N explain the body's tip compliance "
            f"{measured.mean(axis=0)} m/N best, but none may vanish; check the reduced model's statics under tip forces"
        )
    return 1.0 / soft
