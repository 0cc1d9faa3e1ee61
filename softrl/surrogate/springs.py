"""The joints' springs: how a gap yields to loads depends on the commanded pose, and bellows near the base yield more."""

from typing import NamedTuple

import numba as nb
import numpy as np

from softrl.artifacts.surrogate import Surrogate

TERMS, QUADRATIC = 20, 10  # monomials of three variables up to degree three, and up to degree two


class Springs(NamedTuple):
    """Softness of the gaps' joints as a function of the grouped command.

    Attributes
    ----------
    coefficients : (terms, 6), fewer terms where the degree is lower, of the Cholesky factor L of a mean gap's softness
        S = L L', in rad/(N m), m/N and between: columns log L11, log L22, log L33, L21, L31, L32, rows the monomials of
        the command scaled to -1 .. 1
    share : (gaps,) by which each gap is softer than the mean gap
    low, high : (3,) rad, rad, m: range of the command; outside the softness stays that at the border

    Notes
    -----
    A pressurised wall is stiffer, and a bent one yields across its bend when pulled along: springs of one value could
    not follow that. For a given command the springs are linear, so that the chain keeps an energy.
    """

    coefficients: np.ndarray
    share: np.ndarray
    low: np.ndarray
    high: np.ndarray


def springs_of(surrogate: Surrogate) -> Springs:
    """Return the springs of a surrogate; one without coefficients has ``joint_stiffness`` in every pose."""
    s = surrogate
    if not s.softness_coefficients.size:
        return Springs(constant(s.joint_stiffness), np.ones(s.gaps), s.joint_low, s.joint_high)
    return Springs(
        np.ascontiguousarray(s.softness_coefficients), np.ascontiguousarray(s.gap_share), s.joint_low, s.joint_high
    )


def constant(stiffness: np.ndarray) -> np.ndarray:
    """Return the coefficients (terms, 6) of springs of ``stiffness`` (3,) N m/rad, N m/rad, N/m in every pose."""
    coefficients = np.zeros((TERMS, 6))
    coefficients[0, :3] = -0.5 * np.log(stiffness)
    return coefficients


@nb.njit(cache=True)
def softness_at(theta: np.ndarray, springs: Springs) -> np.ndarray:
    """Return the softness S (3, 3) of a mean gap at the grouped command ``theta`` (3,)."""
    terms, factor = monomials(theta, springs.low, springs.high), np.zeros((3, 3))
    values = terms[: len(springs.coefficients)] @ springs.coefficients
    for i in range(3):
        factor[i, i] = np.exp(values[i])
    factor[1, 0], factor[2, 0], factor[2, 1] = values[3], values[4], values[5]
    return factor @ factor.T


@nb.njit(cache=True)
def monomials(theta: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the monomials (terms,) of the command scaled to -1 .. 1 between its limits, low degrees first."""
    terms, scaled = np.empty(TERMS), np.empty(3)
    terms[0], count = 1.0, 4
    for i in range(3):
        share = (theta[i] - low[i]) / (high[i] - low[i])
        scaled[i] = 2.0 * min(max(share, 0.0), 1.0) - 1.0
        terms[1 + i] = scaled[i]
    for i in range(3):
        for j in range(i, 3):
            terms[count] = scaled[i] * scaled[j]
            count += 1
    for i in range(3):
        for j in range(i, 3):
            for k in range(j, 3):
                terms[count] = scaled[i] * scaled[j] * scaled[k]
                count += 1
    return terms


def stiffness_matrix(theta: np.ndarray, springs: Springs) -> np.ndarray:
    """Return K (3 gaps, 3 gaps) of all joints at the grouped command ``theta`` (3,), a block per gap."""
    block = np.linalg.inv(softness_at(np.ascontiguousarray(theta, dtype=float), springs))
    return np.kron(np.diag(1.0 / springs.share), block)
