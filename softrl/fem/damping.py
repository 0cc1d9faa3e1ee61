"""Viscosity of the material: stiffness-proportional damping that is objective and never drives a motion.

The plain tangent makes a poor damping matrix: its geometric part is negative where the body is compressed, so that a
column pushed from both ends is driven, not damped, and a rigid turn of a stressed body is resisted. In a time step the
change of Green's strain is resisted, not its rate at some moment: a part that turns by a few degrees in a step would be
resisted as if it were strained, and in what stretches least.
"""

import numba as nb
import numpy as np

from softrl.fem.law import LAW, STRESS, TANGENT
from softrl.fem.material import Material, lame


def viscous_moduli(material: Material, mean_volume: bool) -> tuple[np.ndarray, float]:
    """Return ((lambda, mu), bulk) in Pa: what ``viscous`` takes, and what an element's mean rate of volume is weighed by.

    Together they are the elastic moduli of ``material`` at rest. With ``mean_volume`` the second is the bulk modulus and
    what is left resists changes of shape alone, as in the elastic energy of such elements; else it is zero.
    """
    lam, mu = lame(material.youngs_modulus_pa, material.poisson)
    if mean_volume:
        return np.array([-2.0 / 3.0 * mu, mu]), lam + 2.0 / 3.0 * mu
    return np.array([lam, mu]), 0.0


@nb.njit(LAW, cache=True)
def viscous(parameters: np.ndarray, f: np.ndarray, p: np.ndarray, a: np.ndarray, order: int) -> float:
    """Fill the tangent ``a`` of a second-order Kelvin-Voigt stress: P' = A F' with S' = lambda tr(E') + 2 mu E'.

    E' is the rate of Green's strain, so a rigid rotation costs nothing and ``F':A:F'`` is never negative; at rest A is
    the elastic tangent. There is no energy and no stress.
    """
    lam, mu = parameters[0], parameters[1]
    if order < TANGENT:
        return 0.0
    for i in range(3):
        for k in range(3):
            left = f[i, 0] * f[k, 0] + f[i, 1] * f[k, 1] + f[i, 2] * f[k, 2]
            for j in range(3):
                for m in range(3):
                    a[3 * i + j, 3 * k + m] = lam * f[i, j] * f[k, m] + mu * f[i, m] * f[k, j]
                a[3 * i + j, 3 * k + j] += mu * left
    return 0.0


@nb.njit(cache=True)
def add_rub(
    lam: float, mu: float, f: np.ndarray, before: np.ndarray, p: np.ndarray, a: np.ndarray, order: int
) -> float:
    """Return lambda/2 tr(D)^2 + mu D:D with D the change of Green's strain from ``before`` (3, 3) to ``f``.

    Its first derivative is added to ``p`` (3, 3), its second to ``a`` (9, 9), as far as ``order`` asks.
    """
    change, total, size = np.empty((3, 3)), 0.0, 0.0
    for i in range(3):
        for j in range(3):
            strain = 0.0
            for k in range(3):
                strain += 0.5 * (f[k, i] * f[k, j] - before[k, i] * before[k, j])
            change[i, j] = strain
            size += strain * strain
        total += change[i, i]
    if order >= STRESS:
        for m in range(3):
            for j in range(3):
                change[m, j] = 2.0 * mu * change[m, j] + (lam * total if m == j else 0.0)  # now the stress
        for i in range(3):
            for j in range(3):
                for m in range(3):
                    p[i, j] += f[i, m] * change[m, j]
    if order >= TANGENT:
        for i in range(3):
            for k in range(3):
                left = mu * (f[i, 0] * f[k, 0] + f[i, 1] * f[k, 1] + f[i, 2] * f[k, 2])
                for j in range(3):
                    for m in range(3):
                        a[3 * i + j, 3 * k + m] += lam * f[i, j] * f[k, m] + mu * f[i, m] * f[k, j]
                        if i == k:
                            a[3 * i + j, 3 * k + m] += change[m, j]
                    a[3 * i + j, 3 * k + j] += left
    return 0.5 * lam * total * total + mu * size
